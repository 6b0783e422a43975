/**
 * The token that authorizes commands. The link that jostled prints contains it in the fragment, which
 * browsers do not send to servers. It is stored for this tab only.
 */
import { store, stored } from "./storage.ts";

const KEY = "jostle-token";

let token: string | null = null;

/** Reads the token from the address bar, and removes it there, or from session storage. */
export function findToken(): void {
  const found = /^#(?:.*&)?token=([0-9A-Za-z_-]+)(?:&(.*))?$/.exec(location.hash);
  if (found?.[1]) {
    keepToken(found[1]);
    history.replaceState(
      null,
      "",
      location.pathname + location.search + (found[2] ? `#${found[2]}` : "#/"),
    );
    return;
  }
  token = stored(KEY);
}

/** Stores a token or the token of a pasted link; an empty text removes it. */
export function keepToken(pasted: string): void {
  const bare = pasted.trim().replace(/^.*token=/, "");
  token = bare === "" ? null : bare;
  store(KEY, token);
}

export function currentToken(): string | null {
  return token;
}

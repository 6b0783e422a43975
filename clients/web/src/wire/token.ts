/**
 * The token that lets the page command. It comes in the link that jostled prints, in the fragment,
 * which no server is ever sent; it is kept for this tab alone.
 */
const KEY = "jostle-token";

let token: string | null = null;

/** Takes the token out of the address bar, or out of what this tab keeps. */
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
  try {
    token = sessionStorage.getItem(KEY);
  } catch {
    token = null;
  }
}

/** Keeps a token, also one pasted with the link around it; an empty one is forgotten. */
export function keepToken(pasted: string): void {
  const bare = pasted.trim().replace(/^.*token=/, "");
  token = bare === "" ? null : bare;
  try {
    if (token) {
      sessionStorage.setItem(KEY, token);
    } else {
      sessionStorage.removeItem(KEY);
    }
  } catch {
    // A browser that keeps nothing still has it until the tab is closed.
  }
}

export function currentToken(): string | null {
  return token;
}

/** Pages by the address's fragment: `#/`, `#/?QUERY`, `#/swarm/NAME`, `#/gallery`, `#/gallery/NAME`. */

export interface Page {
  readonly element: HTMLElement;
  readonly title: string;
  /** Handles a key; returns whether it did. */
  key?(event: KeyboardEvent): boolean;
  end(): void;
}

export type Route =
  | { page: "list" }
  | { page: "swarm"; name: string }
  | { page: "gallery"; name: string | null };

export function parseRoute(hash: string): Route {
  const [page, name] = hash.replace(/^#\/?|\?.*$/g, "").split("/");
  if (page === "swarm" && name) {
    return { page, name: decodeURIComponent(name) };
  }
  if (page === "gallery") {
    return { page, name: name ? decodeURIComponent(name) : null };
  }
  return { page: "list" };
}

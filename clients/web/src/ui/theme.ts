/** The colour theme: the system's, or the one chosen in this tab. */
import { store, stored } from "../wire/storage.ts";
import { callAll } from "./dom.ts";

const KEY = "jostle-theme";

const system = matchMedia("(prefers-color-scheme: dark)");
const listeners = new Set<() => void>();
let chosen = stored(KEY);

function apply(): void {
  document.documentElement.dataset.theme = isDark() ? "dark" : "light";
  callAll(listeners);
}

export function startTheme(): void {
  system.addEventListener("change", apply);
  apply();
}

export function isDark(): boolean {
  return chosen === null ? system.matches : chosen === "dark";
}

export function switchTheme(): void {
  const next = isDark() ? "light" : "dark";
  // If the choice equals the system's theme, the page follows the system again.
  chosen = (next === "dark") === system.matches ? null : next;
  store(KEY, chosen);
  apply();
}

export function onTheme(listener: () => void): () => void {
  listeners.add(listener);
  return () => listeners.delete(listener);
}

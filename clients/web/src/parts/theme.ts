/** Light or dark: as the system has it, or as somebody has switched it in this tab. */

const KEY = "jostle-theme";

const system = matchMedia("(prefers-color-scheme: dark)");
const listeners = new Set<() => void>();
let chosen: string | null = null;

try {
  chosen = sessionStorage.getItem(KEY);
} catch {
  chosen = null;
}

function apply(): void {
  document.documentElement.dataset.theme = isDark() ? "dark" : "light";
  for (const listener of [...listeners]) {
    listener();
  }
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
  // Switched back to what the system has, it follows the system again.
  chosen = (next === "dark") === system.matches ? null : next;
  try {
    if (chosen === null) {
      sessionStorage.removeItem(KEY);
    } else {
      sessionStorage.setItem(KEY, chosen);
    }
  } catch {
    // Then it lasts as long as the page.
  }
  apply();
}

export function onTheme(listener: () => void): () => void {
  listeners.add(listener);
  return () => listeners.delete(listener);
}

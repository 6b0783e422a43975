/** The page that jostled serves. */
import "./style/page.css";
import { galleryPage } from "./pages/gallery.ts";
import { listPage } from "./pages/list.ts";
import { swarmPage } from "./pages/swarm.ts";
import { announcements } from "./parts/announce.ts";
import { el, say } from "./parts/dom.ts";
import { openHelp } from "./parts/help.ts";
import { icon } from "./parts/icons.ts";
import { type Page, parseRoute } from "./parts/router.ts";
import { Session } from "./parts/session.ts";
import { isDark, onTheme, startTheme, switchTheme } from "./parts/theme.ts";
import { openTokenDialog, remedy } from "./parts/token_dialog.ts";
import { findToken } from "./wire/token.ts";

findToken();
startTheme();

const session = new Session();
const main = el("main", { id: "main", tabindex: "-1" });
const links = [el("a", { href: "#/" }, "Swarms"), el("a", { href: "#/gallery" }, "Gallery")];
const rights = el("button", { type: "button", class: "rights" });
const theme = el("button", { type: "button", class: "plain" });
const help = el(
  "button",
  { type: "button", class: "plain", "aria-label": "help", title: "help (?)" },
  "?",
);
const away = el("div", { class: "away", role: "status", hidden: true });

rights.addEventListener("click", () => openTokenDialog(session));
theme.addEventListener("click", switchTheme);
help.addEventListener("click", openHelp);

document.body.append(
  el(
    "a",
    {
      class: "skip",
      href: "#main",
      onclick: (event) => {
        event.preventDefault();
        main.focus();
      },
    },
    "to the content",
  ),
  el(
    "header",
    { class: "top" },
    el("a", { class: "brand", href: "#/" }, "jostle"),
    el("nav", { "aria-label": "pages" }, ...links),
    rights,
    theme,
    help,
  ),
  away,
  main,
  announcements(),
);

onTheme(() => showTheme());
showTheme();
function showTheme(): void {
  theme.replaceChildren(icon(isDark() ? "sun" : "moon"));
  theme.setAttribute("aria-label", isDark() ? "switch to light" : "switch to dark");
  theme.title = theme.getAttribute("aria-label") ?? "";
}

session.onChange(() => {
  const sign = session.mayCommand ? "●" : "○";
  const mayLook = session.mayWatch ? "watching only" : "not known";
  const may = session.mayCommand ? "may command" : mayLook;
  const words = session.person === null ? may : `${session.person}, ${session.hello?.role}`;
  rights.replaceChildren(sign, el("span", {}, words));
  rights.setAttribute("aria-label", words);
  const title = session.knowsPeople ? "who this tab is" : "how to command";
  rights.title = session.mayCommand ? "this tab has a token that may command" : title;
  tellAway();
});
session.live.listen({ connection: tellAway });

function tellAway(): void {
  const isAway = session.live.connection === "away";
  away.hidden = !isAway;
  if (!isAway) {
    say(away, "");
  } else if (session.mayWatch) {
    say(away, "The daemon is away, trying again …");
  } else {
    away.replaceChildren(...remedy(session));
  }
}

let page: Page | null = null;

function open(): void {
  page?.end();
  const route = parseRoute(location.hash);
  if (route.page === "swarm") {
    page = swarmPage(route.name, session);
  } else if (route.page === "gallery") {
    page = galleryPage(route.name, session);
  } else {
    page = listPage(session);
  }
  main.replaceChildren(page.element);
  document.title = `${page.title} – jostle`;
  const here = route.page === "gallery" ? 1 : 0;
  links[here]!.setAttribute("aria-current", "page");
  links[1 - here]!.removeAttribute("aria-current");
  scrollTo(0, 0);
}

/** Keys that belong to whatever has the focus. */
function isTyped({ target, key }: KeyboardEvent): boolean {
  const element = target as Element;
  // Esc ends a mode of the picture from a field of the page, too.
  if (key === "Escape" && !element.closest("dialog")) {
    return false;
  }
  if (element.closest("input[type=range]") && !/^(Arrow|Home|End|Page)/.test(key)) {
    return false;
  }
  if (element.closest("input, select, textarea, dialog")) {
    return true;
  }
  const presses = key === " " && element.closest("button, summary, a");
  const scrolls = key.startsWith("Arrow") && element.closest(".events, .toolbar");
  return Boolean(presses || scrolls);
}

addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || isTyped(event)) {
    return;
  }
  if (event.key === "?") {
    openHelp();
  } else if (!page?.key?.(event)) {
    return;
  }
  event.preventDefault();
});
addEventListener("hashchange", () => {
  findToken();
  void session.ask();
  open();
});

open();

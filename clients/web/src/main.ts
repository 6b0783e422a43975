/** Entry point of the page that jostled serves. */
import "./style/page.css";
import { galleryPage } from "./pages/gallery.ts";
import { listPage } from "./pages/list.ts";
import { swarmPage } from "./pages/swarm.ts";
import { announcements, endNoReply } from "./ui/announce.ts";
import { button, el, setText } from "./ui/dom.ts";
import { openHelp } from "./ui/help.ts";
import { icon } from "./ui/icons.ts";
import { type Page, parseRoute } from "./ui/router.ts";
import { Session } from "./ui/session.ts";
import { isDark, onTheme, startTheme, switchTheme } from "./ui/theme.ts";
import { lostText, openTokenDialog, remedy } from "./ui/token_dialog.ts";
import { findToken } from "./wire/token.ts";

findToken();
startTheme();

const session = new Session();
const main = el("main", { id: "main", tabindex: "-1" });
const links = [el("a", { href: "#/" }, "Swarms"), el("a", { href: "#/gallery" }, "Gallery")];
const rights = button("", () => openTokenDialog(session), "rights");
const theme = button("", switchTheme, "plain");
const help = button("?", openHelp, "plain");
help.setAttribute("aria-label", "help");
help.title = "help (?)";
const connectionNotice = el("div", { class: "notice", role: "status", hidden: true });

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
    "Skip to the content",
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
  connectionNotice,
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
  const mayLook = session.mayWatch ? "watch only" : "no access";
  const may = session.mayCommand ? "may command" : mayLook;
  const words = session.person === null ? may : `${session.person}, ${session.hello?.role}`;
  rights.replaceChildren(sign, el("span", {}, words));
  rights.setAttribute("aria-label", words);
  const title = session.hasUsers ? "your access" : "how to get permission to send commands";
  rights.title = session.mayCommand ? "this tab may send commands" : title;
  showConnection();
});
session.live.listen({ connection: showConnection });

function showConnection(): void {
  const isLost = session.live.connection === "lost";
  if (session.live.connection === "open") {
    endNoReply();
  }
  connectionNotice.hidden = !isLost;
  if (!isLost) {
    setText(connectionNotice, "");
  } else if (session.mayWatch) {
    setText(connectionNotice, lostText(session));
  } else {
    connectionNotice.replaceChildren(...remedy(session));
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

/** Whether the focused element handles the key itself. */
function isTyped({ target, key }: KeyboardEvent): boolean {
  const element = target as Element;
  // Esc in a field also cancels a mode of the picture.
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
  void session.refresh();
  open();
});

open();

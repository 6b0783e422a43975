/** Entry point of the player: a file that contains a run or a recording, and plays it without network. */
import "../style/player.css";
import { button, el, setText } from "../ui/dom.ts";
import { icon } from "../ui/icons.ts";
import { isDark, onTheme, startTheme, switchTheme } from "../ui/theme.ts";
import { sha256 } from "../wire/module.ts";
import { ClaimPanel } from "./claim.ts";
import { type Content, type Contents, licencesOf, readContents, unpack } from "./file.ts";
import { decodeFrames } from "./frames.ts";
import { RunPlayer } from "./run.ts";
import { Stage } from "./stage.ts";
import { Timeline } from "./timeline.ts";

document.getElementById("reading")?.remove();
startTheme();
const themeButton = button("", switchTheme, "plain");
const showTheme = () => {
  themeButton.replaceChildren(icon(isDark() ? "sun" : "moon"));
  themeButton.setAttribute("aria-label", isDark() ? "switch to light" : "switch to dark");
};
onTheme(showTheme);
showTheme();
const main = el("main", { id: "main", tabindex: "-1" });
document.body.append(
  el(
    "header",
    { class: "top" },
    el("span", { class: "brand" }, "jostle"),
    el("nav", {}),
    themeButton,
  ),
  main,
);

try {
  open(readContents());
} catch (error) {
  main.append(el("p", { class: "notice", role: "alert" }, String((error as Error).message)));
}

function panel(title: string, kind: string, isOpen: boolean, ...children: Node[]): HTMLElement {
  const content = el("div", {}, ...children);
  return el("details", { class: `panel ${kind}`, open: isOpen }, el("summary", {}, title), content);
}

function open({ content, module }: Contents): void {
  const { name, run } = content;
  const stage = new Stage(name);
  const claim = new ClaimPanel();
  const aside = el(
    "aside",
    { class: "panels" },
    panel(titleOfClaim(content), "claim", true, claim.element),
  );
  const about = aboutOf(content);
  main.append(
    el(
      "div",
      { class: "page swarm-page show-page player-page" },
      el(
        "header",
        { class: "page-head" },
        el("h1", {}, name),
        run && run.name !== name
          ? el("span", { class: "soft" }, `run ${run.index + 1}, ${run.name}`)
          : null,
        content.kind === "run" && claim.chip,
      ),
      stage.element,
      aside,
    ),
  );
  addEventListener("keydown", (event) => {
    const target = event.target as Element;
    const isOwn = target.closest("input, select, button, summary, pre, dialog");
    const isPan = event.key.startsWith("Arrow") && !target.closest(".view");
    if (
      !event.ctrlKey &&
      !event.metaKey &&
      !event.altKey &&
      !isOwn &&
      !isPan &&
      stage.key(event.key)
    ) {
      event.preventDefault();
    }
  });
  if (content.kind === "run" && module !== "") {
    const player = new RunPlayer(content, stage, claim);
    aside.append(panel("Change a parameter", "later", innerWidth > 900, player.parameters.element));
    aside.append(...about.elements);
    void player.begin(module).then(about.showModule);
  } else {
    aside.append(...about.elements);
    void playFrames(content, stage, claim);
  }
}

function titleOfClaim({ kind }: Content): string {
  return kind === "run" ? "Is it the published result?" : "What this file shows";
}

/** Plays stored frames, without an engine. */
async function playFrames(content: Content, stage: Stage, panel: ClaimPanel): Promise<void> {
  const { frames, claim, kind } = content;
  try {
    if (!frames) {
      throw new Error("this file has neither an engine nor frames");
    }
    const shown = decodeFrames(new Uint8Array(await unpack(frames.data)), frames);
    const timeline = new Timeline(frames.dt, 0);
    timeline.add(shown);
    timeline.total = timeline.end;
    stage.open(timeline);
    if (kind === "run") {
      panel.say(
        "not computed: this file contains frames, and no engine",
        "It plays what was computed elsewhere, and proves nothing. To verify it: jostle check FILE.html.",
      );
      panel.publish(claim ?? null);
    } else {
      panel.say(
        "a recording",
        `It plays ${shown.length} frames. Nothing is computed, so nothing is claimed or proved.`,
      );
    }
  } catch (error) {
    panel.say(`cannot be played: ${(error as Error).message}`);
  }
}

/** The panels that say what the file contains. */
function aboutOf(content: Content) {
  const { version, model_version, files, licences } = content;
  const hash = el("code", {}, "–");
  const engine = el(
    "div",
    { hidden: true },
    el("dt", {}, "SHA-256 of the engine"),
    el("dd", {}, hash),
  );
  const about = panel(
    "About this file",
    "later",
    false,
    el(
      "p",
      {},
      `Written by jostle ${version}, model version ${model_version}. It opens without a network: all ` +
        "that it needs is inside, and it sends nothing.",
    ),
    el("dl", { class: "hashes" }, engine),
    ...(licences ? [licenceTexts(content)] : []),
  );
  const commands = files && panel("The experiment file", "later", false, text(files.toml));
  return {
    elements: commands ? [commands, about] : [about],
    showModule: async (module: ArrayBuffer | null) => {
      const digits = module && (await sha256(module));
      engine.hidden = !digits;
      setText(hash, digits ?? "");
    },
  };
}

/** The licence texts, which are unpacked once they are to be read. */
function licenceTexts(content: Content): HTMLElement {
  const texts = text("");
  const element = el("details", {}, el("summary", {}, "Licences"), texts);
  element.addEventListener("toggle", async () => setText(texts, await licencesOf(content)), {
    once: true,
  });
  return element;
}

function text(content: string): HTMLElement {
  return el("pre", { tabindex: "0" }, content);
}

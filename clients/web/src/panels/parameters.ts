/** All parameters with value, range and unit; a field for each that `set` changes. */
import { announce, attempt } from "../ui/announce.ts";
import { el, setText } from "../ui/dom.ts";
import { Followed, rowForm } from "../ui/field.ts";
import { short } from "../ui/format.ts";
import { command } from "../wire/http.ts";
import type { Parameter } from "../wire/messages.ts";
import type { Choice } from "../wire/page.ts";
import { rangeOf } from "./ranges.ts";

/** The additional argument of each kind of attraction. */
const NEEDS: Record<string, { name: string; usual: string }> = {
  metric: { name: "radius", usual: "3" },
  topological: { name: "neighbours", usual: "7" },
  power: { name: "exponent", usual: "-1" },
};

/** Which commands change a parameter. */
function changes(it: Parameter): string {
  if (!it.live) {
    return "chosen at creation";
  }
  return it.changed_by.includes("set") ? "" : `changed by ${it.changed_by.join(" and ")}`;
}

export class Parameters {
  readonly element = el("div", {
    class: "parameters",
    tabindex: "0",
    role: "region",
    "aria-label": "parameters",
  });
  private readonly values = new Map<string, { value: unknown; show: (it: Parameter) => void }>();
  private key = "";

  constructor(private readonly swarm: string) {}

  /** Shows the parameters. If only values changed, the fields are kept, with what is being typed. */
  show(parameters: Parameter[], mayCommand: boolean): void {
    const key = `${mayCommand} ${parameters.map((it) => it.name).join(" ")}`;
    if (key !== this.key) {
      this.key = key;
      this.values.clear();
      this.element.replaceChildren(...parameters.map((it) => this.row(it, mayCommand)));
    }
    for (const it of parameters) {
      this.values.get(it.name)?.show(it);
    }
  }

  private row(it: Parameter, mayCommand: boolean): HTMLElement {
    const value = el("output", { class: "value" });
    const about = el("small", {}, [rangeOf(it), changes(it)].filter(Boolean).join(" · "));
    const label = el("b", { id: `parameter-${it.name}` }, it.name);
    const head = el("div", { class: "head", title: it.doc }, label, value);
    const doc = el("small", { class: "doc" }, it.doc);
    const row = el("div", { class: "parameter" }, head, about, doc);
    let followed: Followed | null = null;
    let newest = it;
    if (mayCommand && it.live && it.changed_by.includes("set")) {
      const { form, fill } = this.editor(it, (accepted) => followed?.sent(accepted));
      followed = new Followed(form, () => fill(newest));
      row.append(form);
    }
    const show = (it: Parameter) => {
      newest = it;
      const text =
        it.value === null && it.name === "rate" ? "as fast as possible" : short(it.value);
      const changed = value.textContent !== text;
      setText(value, text);
      followed?.show(changed);
    };
    this.values.set(it.name, { value: it.value, show });
    return row;
  }

  /** The form of a parameter; `sent` is called with whether the daemon accepted what it sent. */
  private editor(
    it: Parameter,
    sent: (accepted: boolean) => void,
  ): { form: HTMLFormElement; fill: (it: Parameter) => void } {
    const labelled = { "aria-labelledby": `parameter-${it.name}` };
    const button = el("button", { "aria-label": `set ${it.name}` }, "Set");
    if (it.kind === "choice") {
      const names = (it.choices as Choice[]).map((choice) =>
        typeof choice === "string" ? choice : choice.kind,
      );
      const select = el(
        "select",
        labelled,
        ...names.map((name) => el("option", { value: name }, name)),
      );
      const extra = el("input", { type: "number", step: "any", class: "extra", hidden: true });
      const adapt = () => {
        const needs = NEEDS[select.value];
        extra.hidden = needs === undefined;
        extra.required = needs !== undefined;
        extra.setAttribute("aria-label", needs?.name ?? "");
        extra.title = needs?.name ?? "";
        extra.value ||= needs?.usual ?? "";
      };
      select.addEventListener("change", () => {
        extra.value = "";
        adapt();
      });
      const send = async () => {
        const needs = NEEDS[select.value];
        const chosen =
          it.name === "attraction"
            ? { kind: select.value, ...(needs ? { [needs.name]: extra.valueAsNumber } : {}) }
            : select.value;
        sent(await this.set({ [it.name]: chosen }));
      };
      const fill = ({ value }: Parameter) => {
        const kind = typeof value === "object" && value ? (value as { kind: string }).kind : value;
        select.value = String(kind);
        const needs = NEEDS[select.value];
        extra.value = needs ? short((value as Record<string, unknown>)[needs.name]) : "";
        adapt();
      };
      return { form: rowForm(send, select, extra, button), fill };
    }
    const input = el("input", {
      ...labelled,
      type: "number",
      step: it.kind === "integer" ? "1" : "any",
      min: it.minimum === null ? null : String(it.minimum),
      max: it.maximum === null ? null : String(it.maximum),
      required: true,
    });
    const parts: Node[] = [input];
    const makeRoom = el("input", { type: "checkbox" });
    if (it.name === "pi1") {
      const title = "scale the positions by the least factor that lets the new bodies fit";
      parts.push(el("label", { class: "check", title }, makeRoom, "make room"));
    }
    const send = async () => {
      const room = makeRoom.checked ? { make_room: true } : {};
      sent(await this.set({ [it.name]: input.valueAsNumber, ...room }));
    };
    const fill = ({ value }: Parameter) => {
      input.value = short(value);
    };
    return { form: rowForm(send, ...parts, button), fill };
  }

  /** Sets parameters; returns whether the daemon accepted them. */
  private async set(args: Record<string, unknown>): Promise<boolean> {
    const reply = await attempt(() => command<Record<string, unknown>>(this.swarm, "set", args));
    if (reply) {
      const [name, value] = Object.entries(args)[0]!;
      announce(`${name} is ${short(value)} from step ${reply.step} on`);
    }
    return reply !== null;
  }
}

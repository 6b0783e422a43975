/** Creates a swarm. */
import { announce, attempt } from "../parts/announce.ts";
import { openDialog } from "../parts/dialog.ts";
import { el } from "../parts/dom.ts";
import { form, nameField, numberField, numberIn } from "../parts/field.ts";
import { command, commandNode } from "../wire/http.ts";
import type { Spec } from "../wire/messages.ts";

/** What can be chosen, with the range of each; what is left empty is the daemon's default. */
const FIELDS = {
  n: { label: "n", unit: "individuals", value: "50", min: "1", step: "1", required: true },
  pi1: { label: "pi1", unit: "length over width", placeholder: "4", min: "1", max: "32" },
  pi2: { label: "pi2", unit: "weight of a direction", placeholder: "0.5", min: "0" },
  pi3: { label: "pi3", unit: "size over turning radius", placeholder: "1", min: "0" },
  pi4: { label: "pi4", unit: "translational over rotational drag", placeholder: "10", min: "0" },
  dt: { label: "dt", unit: "time step", placeholder: "0.02", min: "0" },
  seed: { label: "seed", unit: "of every draw", placeholder: "0", min: "0", step: "1" },
  rate: { label: "rate", unit: "time units / s", placeholder: "1", min: "0" },
} as const;

export function openCreate(): void {
  const name = nameField("name", "swarm-1");
  const fields = Object.entries(FIELDS).map(([key, it]) => ({ key, ...numberField(it) }));
  const runs = el("input", { type: "checkbox", checked: true });
  const entry = form(
    { class: "grid-form" },
    async () => {
      const chosen = fields.map(({ key, input }) => [key, numberIn(input)] as const);
      const spec = Object.fromEntries(chosen.filter(([, value]) => value !== undefined));
      if (await create(name.input.value, spec as unknown as Spec, runs.checked)) {
        dialog.close();
        location.hash = `#/swarm/${name.input.value}`;
      }
    },
    name.label,
    ...fields.map(({ label }) => label),
    el("label", { class: "check" }, runs, "run it at once"),
    el("button", { class: "primary" }, "Create"),
  );
  const dialog = openDialog("Create a swarm", entry);
  name.input.select();
}

async function create(name: string, spec: Spec, runs: boolean): Promise<boolean> {
  if (!(await attempt(() => commandNode("create", { name, spec })))) {
    return false;
  }
  if (runs) {
    await attempt(() => command(name, "run"));
  }
  announce(`${name} is created`);
  return true;
}

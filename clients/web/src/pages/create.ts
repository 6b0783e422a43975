/** The dialog that creates a swarm. */
import { announce, attempt } from "../ui/announce.ts";
import { openDialog } from "../ui/dialog.ts";
import { el } from "../ui/dom.ts";
import { form, nameField, numberField, numberIn } from "../ui/field.ts";
import { command, commandNode } from "../wire/http.ts";
import type { Spec } from "../wire/requests.ts";

/** The fields with their ranges; an empty field means the daemon's default. */
const FIELDS = {
  n: { label: "n", unit: "individuals", value: "50", min: "1", step: "1", required: true },
  pi1: { label: "pi1", unit: "length over width", placeholder: "4", min: "1", max: "32" },
  pi2: { label: "pi2", unit: "weight of a direction", placeholder: "0.5", min: "0" },
  pi3: { label: "pi3", unit: "size over turning radius", placeholder: "1", min: "0" },
  pi4: { label: "pi4", unit: "translational over rotational drag", placeholder: "10", min: "0" },
  dt: { label: "dt", unit: "time step", placeholder: "0.02", min: "0" },
  seed: { label: "seed", unit: "of all random numbers", placeholder: "0", min: "0", step: "1" },
  rate: { label: "rate", unit: "time units / s", placeholder: "1", min: "0" },
} as const;

export function openCreate(): void {
  const name = nameField("name", "swarm-1");
  const fields = Object.entries(FIELDS).map(([key, it]) => ({ key, ...numberField(it) }));
  const runs = el("input", { type: "checkbox", checked: true });
  const entry = form(
    "grid-form",
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
    el("label", { class: "check" }, runs, "run after creation"),
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
  announce(`${name} created`);
  return true;
}

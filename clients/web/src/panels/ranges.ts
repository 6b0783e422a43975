/** The range and unit of a parameter, as text. */
import { short } from "../ui/format.ts";
import type { Parameter } from "../wire/messages.ts";
import type { Choice } from "../wire/page.ts";

export function rangeOf(it: Parameter): string {
  if (it.kind === "choice") {
    return (it.choices as Choice[])
      .map((choice) => (typeof choice === "string" ? choice : choice.kind))
      .join(", ");
  }
  const from = it.minimum ?? it.exclusive_minimum;
  const least =
    from === null ? "" : it.minimum === null ? `above ${short(from)}` : `from ${short(from)}`;
  const most = it.maximum === null ? "" : ` to ${short(it.maximum)}`;
  const unit = it.unit === "1" ? "" : ` ${it.unit}`;
  return least + most + unit + (it.nullable ? ", or none" : "");
}

/** How the charts of the series are drawn. */
import { fixed, signed } from "../ui/format.ts";
import type { Series } from "./history.ts";
import type { Kind } from "./plot.ts";

const NONE = "no values yet";

export const KINDS: Record<Series, Kind> = {
  order: {
    title: "order",
    about: "1: all headings equal",
    format: (it) => fixed(it, 3),
    range: [0, 1],
    colour: "--chart-1",
    none: NONE,
  },
  drift: {
    title: "drift",
    about: "speed along the common direction of the informed",
    format: (it) => signed(it, 3),
    range: [-1, 1],
    colour: "--chart-2",
    none: "no common direction",
  },
  contacts: {
    title: "contacts",
    about: "pairs near enough to constrain",
    format: (it) => fixed(it, 0),
    colour: "--chart-3",
    none: NONE,
  },
  real_time_factor: {
    title: "real-time factor",
    about: "time units per second",
    format: (it) => fixed(it, 2),
    colour: "--chart-4",
    none: NONE,
  },
};

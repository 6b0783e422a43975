/** Icons as SVG paths: fonts differ in the symbols they contain. */
import { svg } from "./dom.ts";

const PATHS = {
  follow: "M12 2v5M12 17v5M2 12h5M17 12h5M12 7a5 5 0 1 0 0 10 5 5 0 0 0 0-10M12 11.5v1",
  headings: "M12 3a9 9 0 1 0 0 18 9 9 0 0 0 0-18M16 8l-2.500 5.500L8 16l2.500-5.500z",
  contacts: "M12 6l6 6-6 6-6-6zM2 12h4M18 12h4",
  clusters:
    "M5 9l6-4M8 14l7-5M15 17l5-4M3 7.5C3 3 15 1 17 6.5c2 0 6 3 4 7.5s-8 6-10 2.500C6 19 3 14 3 7.500z",
  trails: "M2 19c4 0 4-5 8-5s4-7 9-7M2 12c3 0 4-4 7-4M16 4l4 3-3 4",
  preferences: "M4 20L19 5M19 5h-7M19 5v7",
  lasso:
    "M12 4c5 0 9 2.500 9 6s-4 6-9 6-9-2.500-9-6 4-6 9-6M7 15.500c-2 2 0 5.500 2.500 4.500s1-4-1.500-4.500",
  more: "M12 4v16M4 12h16",
  less: "M4 12h16",
  sun: "M12 7.500a4.500 4.500 0 1 0 0 9 4.500 4.500 0 0 0 0-9M12 1.500v2.500M12 20v2.500M1.500 12h2.500M20 12h2.500M4.600 4.600l1.800 1.800M17.600 17.600l1.800 1.800M4.600 19.400l1.800-1.800M17.600 6.400l1.800-1.800",
  moon: "M20 14.500A8.500 8.500 0 0 1 9.500 4 8.500 8.500 0 1 0 20 14.500z",
} as const;

export type Sign = keyof typeof PATHS;

export function icon(sign: Sign): SVGElement {
  const path = svg("path", { d: PATHS[sign] });
  return svg("svg", { class: "icon", viewBox: "0 0 24 24", "aria-hidden": "true" }, path);
}

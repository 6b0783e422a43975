/**
 * Colours of the picture, light and dark. Bodies have the colours of the Python package's pictures;
 * clusters have numbers and the colours of Okabe and Ito, distinct for colour-blind readers.
 */

export interface Look {
  fill: string;
  edge: string;
}

export interface Colours {
  paper: string;
  grid: string;
  ink: string;
  plain: Look;
  /** The looks of equal ranges of headings, counter-clockwise, the first about +x. */
  headings: Look[];
  informed: Look;
  /** Bodies of a faulted swarm: pale, with a cross. */
  faulted: Look;
  faulted_informed: Look;
  preference: string;
  trail: string;
  selected: string;
  contact: string;
  contact_edge: string;
  label: string;
}

const BODIES = {
  plain: { fill: "#8fb3d1", edge: "#2f5474" },
  informed: { fill: "#f2a154", edge: "#8a4408" },
};

/** Ranges of headings: neighbouring colours differ hardly, as neighbouring headings do. */
const RANGES = 24;

/** Colours of equal lightness around the circle of hues. */
function headings(fill: string, edge: string): Look[] {
  return Array.from({ length: RANGES }, (_, k) => {
    const hue = (360 * k) / RANGES + 30;
    return { fill: `oklch(${fill} ${hue})`, edge: `oklch(${edge} ${hue})` };
  });
}

const LIGHT: Colours = {
  ...BODIES,
  headings: headings("0.76 0.13", "0.58 0.12"),
  faulted: { fill: "#fbfcfd", edge: "#a3141f" },
  faulted_informed: { fill: "#fbdcb9", edge: "#a3141f" },
  paper: "#fbfcfd",
  grid: "#e3e8ed",
  ink: "#1b242d",
  preference: "#c8102e",
  trail: "#4a6f8f",
  selected: "#6a1fb0",
  contact: "#111820",
  contact_edge: "#ffffff",
  label: "#ffffff",
};

const DARK: Colours = {
  plain: { fill: "#9cc0de", edge: "#24425c" },
  headings: headings("0.78 0.13", "0.42 0.1"),
  informed: { fill: "#f6ab61", edge: "#7a3a05" },
  faulted: { fill: "#10151b", edge: "#ff8d8d" },
  faulted_informed: { fill: "#5d3c16", edge: "#ff8d8d" },
  paper: "#10151b",
  grid: "#1f2831",
  ink: "#e4ebf1",
  preference: "#ff5a66",
  trail: "#7ea6c6",
  selected: "#d3a2ff",
  contact: "#ffffff",
  contact_edge: "#10151b",
  label: "#10151b",
};

export const CLUSTERS = ["#009e73", "#cc79a7", "#f0e442", "#0072b2", "#d55e00", "#56b4e9"];

export function colours(is_dark: boolean): Colours {
  return is_dark ? DARK : LIGHT;
}

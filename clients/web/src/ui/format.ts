/** Formats numbers. */

const NOTHING = "–";

export function fixed(value: number | null | undefined, digits: number): string {
  if (value === null || value === undefined || !Number.isFinite(value)) {
    return NOTHING;
  }
  const text = value.toFixed(digits);
  return /^-0\.?0*$/.test(text) ? text.slice(1) : text.replace("-", "−");
}

/** Like `fixed`, with an explicit plus sign. */
export function signed(value: number | null | undefined, digits: number): string {
  const text = fixed(value, digits);
  return value !== null && value !== undefined && value > 0 && Number(text) > 0 ? `+${text}` : text;
}

/** At most six significant digits; integers in full: 0.02, 1e-6, 9007199254740991. */
export function short(value: unknown): string {
  if (typeof value === "number") {
    return Number.isInteger(value) ? String(value) : String(Number(value.toPrecision(6)));
  }
  if (value !== null && typeof value === "object") {
    const entries = Object.entries(value).filter(([, it]) => it !== null);
    return entries
      .map(([name, it]) => (name === "kind" ? short(it) : `${name} ${short(it)}`))
      .join(", ");
  }
  return value === null || value === undefined ? NOTHING : String(value);
}

/** At most four significant digits, a small number in powers of ten: 0.0123, −1.2e-8. */
export function brief(value: number | null | undefined): string {
  if (value === null || value === undefined || !Number.isFinite(value)) {
    return NOTHING;
  }
  const isSmall = value !== 0 && Math.abs(value) < 1e-3;
  const text = isSmall ? value.toExponential(1) : String(Number(value.toPrecision(4)));
  return text.replace(/^-/, "−");
}

/** The labels of an axis: as many decimals as tell its values apart and are exact for them. */
export function ticks(values: number[]): string[] {
  const spacing = Math.abs((values.at(-1) ?? 0) - (values[0] ?? 0)) / (values.length - 1);
  if (!(spacing > 0) || values.every((it) => Math.abs(it) < 1e-3)) {
    return values.map(brief);
  }
  const isExact = (decimals: number) =>
    values.every((it) => Math.abs(it - Number(it.toFixed(decimals))) < 1e-3 * spacing);
  let decimals = 0;
  while (decimals < 12 && !isExact(decimals)) {
    decimals += 1;
  }
  return values.map((it) => String(Number(it.toFixed(decimals))).replace(/^-/, "−"));
}

export function time(value: number): string {
  return value.toFixed(value < 1000 ? 2 : 1);
}

/** A wall-clock time in seconds since 1970 as RFC 3339, UTC; empty if unknown. */
export function when(unixSecs: number | null | undefined): string {
  const date = new Date(Math.round((unixSecs ?? Number.NaN) * 1000));
  return Number.isNaN(date.getTime()) ? "" : date.toISOString();
}

/** Degrees, counter-clockwise from +x, in (-180, 180]. */
export function degrees(radians: number): number {
  const turned = ((radians * 180) / Math.PI) % 360;
  return turned > 180 ? turned - 360 : turned <= -180 ? turned + 360 : turned;
}

/** An angle in degrees, from radians: 90.0°. */
export function angle(radians: number): string {
  return `${fixed(degrees(radians), 1)}°`;
}

export function plural(count: number, one: string, many = `${one}s`): string {
  return `${count} ${count === 1 ? one : many}`;
}

/** `1 step`, `5,000 steps`. */
export function inSteps(count: number): string {
  return `${grouped(count)} ${count === 1 ? "step" : "steps"}`;
}

/** A whole number with a comma between thousands: 5,000. */
export function grouped(value: number): string {
  return value.toLocaleString("en");
}

/** The time that is left; empty if it is not known. */
export function seconds(left: number | null): string {
  if (left === null) {
    return "";
  }
  return left < 90 ? `${Math.ceil(left)} s left` : `${Math.ceil(left / 60)} min left`;
}

/** Frames drawn and states received per second. */
export function rates(pictures: number, states: number): string {
  const [drawn, arrived] = [Math.round(pictures), Math.round(states)];
  return `${plural(drawn, "picture")}, ${plural(arrived, "state")} a second`;
}

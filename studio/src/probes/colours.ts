import { code } from "../shared/tone";

/** Linear RGB as a CSS colour; 1 is white, what exceeds it is cut. */
export const cssColour = (linear: readonly number[]): string =>
  `rgb(${linear.map((value) => code(value)).join(" ")})`;

export const inWords = (linear: readonly number[]): string =>
  linear.map((value) => value.toPrecision(3)).join(", ");

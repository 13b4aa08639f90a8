import { swatch, valueTable } from "../probes/value_table";
import { adds, colourOf } from "./outlines";
import type { Activation } from "./result";

const HEADS = ["Number", "Azimuth", "From straight up", "Width × length", "Strength (R, G, B)", "Light"];

/** Activations with their values, for whoever cannot see the map or wants the numbers. */
export function activationTable(activations: Activation[]): HTMLElement {
  const rows = activations.map((one, i) => [
    swatch(colourOf(one), String(i + 1)),
    `${one.azimuth_deg.toFixed(1)}°`,
    `${one.zenith_deg.toFixed(1)}°`,
    `${one.width_deg.toFixed(1)}° × ${one.length_deg.toFixed(1)}°`,
    one.weight.map((w) => w.toPrecision(3)).join(", "),
    adds(one) ? "added" : "taken away",
  ]);
  return valueTable(`The ${activations.length} pieces as a table`, HEADS, rows);
}

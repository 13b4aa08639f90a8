import { inWords } from "../shared/frame";
import { luminance } from "../shared/radiance_map";
import type { Sky } from "./decoder.worker";

const DEGREES = 180 / Math.PI;

/** Where the sun of a sky stands, and how much of the light on level ground comes from it. */
export function describeSun({ sun, wish, groundIrradiance }: Sky): string {
  const azimuth = wish.azimuth * DEGREES, zenith = sun.zenith * DEGREES;
  const direct = luminance(...sun.energy) * Math.cos(sun.zenith);
  const share = Math.min(1, direct / luminance(...groundIrradiance));
  return (
    `The sun stands ${(90 - zenith).toFixed(0)}° above the horizon (${inWords(azimuth, zenith)}). ` +
    `${(100 * share).toFixed(0)} % of the light on open level ground is its.`
  );
}

import type { EstimateResult } from "../api";
import { balls } from "../shared/ball";
import { el } from "../shared/dom";
import { fromAngles, whereFrom } from "../shared/frame";
import { markDirection, panorama } from "../shared/panorama";
import { prefilter } from "../shared/prefilter";
import type { RadianceMap } from "../shared/radiance_map";
import { drawOutline, outline, posteriorOf } from "./posterior";
import { posteriorBall } from "./posterior_ball";
import { sentence } from "./verdict";

/** An estimate's light: elements for the page to arrange. */
export interface LightView {
  /** The panorama with its legend; `panorama` is the part that lies over the picture. */
  figure: HTMLElement;
  panorama: HTMLElement;
  balls: HTMLElement;
  numbers: HTMLElement;
  advice: HTMLElement[];
  /** Shows another map in panorama and balls; where the sun may be stays as it was found. */
  setMap: (map: RadianceMap) => void;
  setExposure: (factor: number) => void;
}

/** `density` is where the sun or main lamp may stand, per sr; null where none was seen. */
export function lightView(
  title: string,
  result: EstimateResult,
  map: RadianceMap,
  density: RadianceMap | null,
): LightView {
  const { sun } = result;
  const sees = density !== null;
  const main = result.lamps.length > 0 ? "main lamp" : "sun";
  const posterior = density && posteriorOf(density, result.posterior.region_edge_per_sr);

  const words = whereFrom(sun.azimuth_deg, sun.zenith_deg);
  const view = panorama(
    `${title}: the light around the camera as a panorama; ${sees ? `${main} ${words}` : `most light ${words}`}`,
  );
  const towardsSun = fromAngles(sun.azimuth_deg, sun.zenith_deg);
  const pieces = posterior ? outline(posterior) : [];
  view.setOverlay((context, width, height) => {
    if (posterior) drawOutline(context, posterior, pieces, width, height);
    for (const lamp of result.lamps.slice(1)) {
      markDirection(context, fromAngles(lamp.azimuth_deg, lamp.zenith_deg), width, height, "#ffffff");
    }
    markDirection(context, towardsSun, width, height, sees ? "#ffd23f" : "#ffffff");
  });
  view.setMap(map);
  const shown = balls(title);
  shown.setMap(map);
  const ball = posteriorBall(map, posterior, sun, main);
  shown.element.append(ball.element);

  const legend = sees
    ? `Middle: where the camera looks. Ring: the ${main} as found${result.lamps.length > 1 ? ", white the others" : ""}. Line: where it stands in ${Math.round(10 * result.posterior.share)} cases of 10.`
    : "Middle: where the camera looks. Ring: where most light comes from; no sun or lamp stands out.";
  return {
    figure: el("figure", { class: "result-map" }, view.element, el("figcaption", {}, legend)),
    panorama: view.element,
    balls: shown.element,
    numbers: numbers(result, words, sees ? main : "most light"),
    advice: result.advice.map((line) => el("p", { class: "care" }, sentence(line))),
    setMap: (to) => {
      view.setMap(to);
      shown.setMap(to);
    },
    setExposure: (factor) => {
      view.setExposure(factor);
      shown.setExposure(factor);
      ball.setExposure(factor);
    },
  };
}

/** Stops, at most 0, at which a white matt ball just reaches white: what is seen of it is shading. */
export function firstStops(map: RadianceMap): number {
  const most = prefilter(map, 1).data.reduce((a, b) => Math.max(a, b), 0);
  return Math.min(0, Math.floor(-4 * Math.log2(most || 1)) / 4);
}

function numbers(result: EstimateResult, words: string, main: string): HTMLElement {
  const { sun, posterior, faces, seconds } = result;
  const degrees = (value: number): string => `${Math.round(value)}°`;
  const elevation = 90 - sun.zenith_deg;
  const sure = `in ${Math.round(10 * posterior.share)} cases of 10 within an area as large as a circle of ${degrees(posterior.region_radius_deg)} about it`;
  const all = Object.values(seconds).reduce((sum, one) => sum + one, 0);
  const lines: [string, string][] = [
    ...(result.choice
      ? ([["Model", `${result.light}, ${Math.round(100 * result.choice.probability)} % sure`]] as [string, string][])
      : []),
    [sentence(main), sentence(words)],
    ["Turned", `${degrees(Math.abs(sun.azimuth_deg))} to the ${sun.azimuth_deg < 0 ? "left" : "right"} of where the camera looks`],
    ["Height", `${degrees(Math.abs(elevation))} ${elevation < 0 ? "below" : "above"} the horizon`],
    ...(posterior.is_seen ? ([["How sure", sure]] as [string, string][]) : []),
    ...result.lamps.map((lamp, i) => [`Lamp ${i + 1}`, lampInWords(lamp)] as [string, string]),
    ...faces.map(
      (face, i) =>
        [
          faces.length > 1 ? `Face ${i + 1}` : "Face",
          `drawn in this light it differs from the photo by ${Math.round(100 * face.residual)} % on average`,
        ] as [string, string],
    ),
    ["Found in", `${Math.round(all)} s`],
  ];
  return el("dl", { class: "numbers" }, ...lines.flatMap(([term, value]) => [el("dt", {}, term), el("dd", {}, value)]));
}

/** Where a lamp stands, what a surface that faces it receives, and its diameter: four spreads of a lobe. */
function lampInWords({ azimuth_deg, zenith_deg, irradiance, spread_deg }: EstimateResult["lamps"][number]): string {
  const [red, green, blue] = irradiance.map((value) => value.toPrecision(2));
  return `${whereFrom(azimuth_deg, zenith_deg)}; red, green, blue ${red}, ${green}, ${blue} (irradiance); ${Math.round(4 * spread_deg) || "under 1"}° wide`;
}

import type { Verdict } from "../api";
import { el } from "../shared/dom";

export const sentence = (line: string): string => line.charAt(0).toUpperCase() + line.slice(1);

/** How sure direction, brightness and colour are, each with its reason; or why nothing is. */
export function inWordsOf(verdict: Verdict): [string, string][] {
  if (verdict.doubt) return [["Verdict", `Unreliable: ${verdict.doubt}`]];
  return (["direction", "brightness", "colour"] as const).map((name) => {
    const { word, reason } = verdict[name];
    return [sentence(name), `${sentence(word)}: ${reason}`];
  });
}

/** The verdict to be read first: what the light is, how sure that is, what to mind of the only photo. */
export function verdictCard(verdict: Verdict, advice: string[], photo: string): HTMLElement {
  const sure = inWordsOf(verdict).flatMap(([term, words]) => [el("dt", {}, term), el("dd", {}, words)]);
  return el(
    "section",
    { class: "card verdict", "aria-label": "Verdict" },
    el("h2", { tabindex: -1 }, sentence(verdict.light)),
    el("dl", { class: verdict.doubt ? "numbers care" : "numbers" }, ...sure),
    ...advice.map((line) => el("p", { class: "care small" }, sentence(line.replace(`${photo}: `, "")))),
  );
}

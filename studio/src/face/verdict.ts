import type { Verdict } from "../api";

export const sentence = (line: string): string => line.charAt(0).toUpperCase() + line.slice(1);

/** How sure direction, brightness and colour are, each with its reason; or why nothing is. */
export function inWordsOf(verdict: Verdict): [string, string][] {
  if (verdict.doubt) return [["Verdict", `Unreliable: ${verdict.doubt}`]];
  return (["direction", "brightness", "colour"] as const).map((name) => {
    const { word, reason } = verdict[name];
    return [sentence(name), `${sentence(word)}: ${reason}`];
  });
}

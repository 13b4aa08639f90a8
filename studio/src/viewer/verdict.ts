/** What each kind of verdict means to somebody who gets the page and knows nothing else. */
const MEANING: Record<string, string> = {
  reliable: "The face tells where the light came from; how exactly is said below.",
  overcast: "No sun was seen: an even sky, or a sun hidden behind the head.",
  even: "No lamp was seen: even light, or a lamp hidden behind the head.",
  ambiguous: "The face tells too little: the light may have come from elsewhere than shown here.",
  doubtful: "Something contradicts this light: take it as one of several that may have been.",
  unreliable: "Do not trust this light: the face does not look as it would in it.",
};
const SOUND = ["reliable", "overcast", "even"];

/** `isSound` where the light may be used as it is. A verdict is "kind: reason". */
export function inPlainWords(verdict: string): { isSound: boolean; words: string } {
  const kind = verdict.split(":")[0]!;
  return { isSound: SOUND.includes(kind), words: MEANING[kind] ?? "" };
}

/**
 * Seconds of each stage of an estimate: a face of 1000 x 1000 pixels in the light of any place, on
 * one core. How long another takes is this times how much slower it has been so far.
 */
const USUAL_S: Record<string, number> = {
  "reading the picture": 0.2,
  "finding the face": 0.5,
  "fitting the head": 0.2,
  "tracing light": 2.0,
  "estimating the light": 3.9,
  "writing the results": 3.3,
};
const STAGES = Object.keys(USUAL_S);
const ALL_S = Object.values(USUAL_S).reduce((sum, one) => sum + one, 0);
const LEAST = 0.15; // of all: less says nothing about the machine

/** Seconds that are left after so many at this share of a stage; null where nobody knows. */
export function secondsLeft(stage: string, share: number, elapsed: number): number | null {
  const at = STAGES.indexOf(stage);
  if (at < 0) return null;
  const before = STAGES.slice(0, at).reduce((sum, name) => sum + USUAL_S[name]!, 0);
  const done = (before + share * USUAL_S[stage]!) / ALL_S;
  return done < LEAST ? null : (elapsed * (1 - done)) / done;
}

/** "about 20 s left", in steps that the guess deserves. */
export function leftInWords(seconds: number | null): string {
  if (seconds === null) return "";
  if (seconds < 3) return "nearly done";
  const step = seconds < 20 ? 1 : seconds < 60 ? 5 : 30;
  const rounded = Math.round(seconds / step) * step;
  return rounded < 90 ? `about ${rounded} s left` : `about ${Math.round(rounded / 60)} min left`;
}

/** What this tab has estimated so far, for pages that use light found on another; gone with the tab. */
export interface FoundLight {
  job: string;
  title: string;
}
const found: FoundLight[] = [];

export const rememberLight = (light: FoundLight): void => void found.unshift(light);
/** For lights whose jobs the server has been told to forget. */
export function forgetLight(job: string): void {
  const place = found.findIndex((light) => light.job === job);
  if (place >= 0) found.splice(place, 1);
}
export const foundLights = (): readonly FoundLight[] => found;

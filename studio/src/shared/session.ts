import type { Photo } from "../api";

/** An estimate of this tab's photo. */
export interface FoundLight {
  job: string;
  title: string;
}

/**
 * What this tab is at: names of what the studio keeps, and the user's changes; no picture, no map.
 * It outlives a reload, and goes with the tab or with its photo.
 */
export interface Session {
  photo: Photo;
  lights: FoundLight[];
  /** One that is still estimated. */
  running?: FoundLight;
  /** The title of the light that is shown, and the tab. */
  shown?: string;
  tab?: string;
  /** States of histories. */
  edits: Record<string, string>;
}

const KEY = "skylight studio";
let session: Session | null = read();

function read(): Session | null {
  try {
    return JSON.parse(sessionStorage.getItem(KEY) ?? "null") as Session | null;
  } catch {
    return null; // a browser that keeps nothing: a reload begins anew
  }
}

function write(): void {
  try {
    if (session) sessionStorage.setItem(KEY, JSON.stringify(session));
    else sessionStorage.removeItem(KEY);
  } catch {
    // as above
  }
}

export const currentSession = (): Readonly<Session> | null => session;
export function beginSession(photo: Photo): void {
  session = { photo, lights: [], edits: {} };
  write();
}
export function updateSession(change: Partial<Session>): void {
  if (!session) return;
  Object.assign(session, change);
  write();
}
export function endSession(): void {
  session = null;
  write();
}

export const foundLights = (): readonly FoundLight[] =>
  (session?.lights ?? []).map(({ job, title }) => ({ job, title: `${session!.photo.name}: ${title}` })).reverse();

/** The studio's HTTP interface. Everything that fails throws an ApiError with one clear line. */

import type { Edit } from "./shared/edit";

export interface Face {
  number: number;
  box: [x: number, y: number, width: number, height: number];
}
export interface Photo {
  photo: string;
  name: string;
  width: number;
  height: number;
  faces: Face[];
}
export interface LightMap {
  map: string;
  name: string;
  width: number;
  height: number;
}
export interface About {
  version: string;
  limits: { upload_mb: number; megapixels: number; jobs: number };
  /** The light model that a form begins with. */
  light: string;
  lights: { name: string; title: string }[];
  places: { name: string; title: string }[];
  dictionaries: { name: string; title: string }[];
}
/** A photograph to try; `expected` says whether its light is found. */
export interface Example {
  name: string;
  description: string;
  expected: string;
  credit: string;
}
export interface JobFile {
  name: string;
  size: number;
}
export interface Job<Result = unknown> {
  job: string;
  kind: string;
  state: "waiting" | "running" | "done" | "failed" | "cancelled";
  stage: string;
  share: number;
  /** While it waits: how many jobs are done before it. */
  before?: number;
  error?: string;
  result?: Result;
  files?: JobFile[];
}
export interface Angles {
  azimuth_deg: number;
  zenith_deg: number;
}
/** `irradiance` is that of a surface that faces the lamp, RGB. */
export interface MeasuredLamp extends Angles {
  irradiance: [number, number, number];
  spread_deg: number;
}
/** What surfaces receive of the ambient light on average, and the discs that are as wide as the lamps. */
export interface LampFacts {
  ambient_irradiance: [number, number, number];
  diameters_deg: number[];
}
/** How sure one property of the light is, and why. */
export interface Certainty {
  word: "sure" | "rough" | "unknown";
  reason: string;
}
/** `light` is a sentence about the map; `doubt` why none of it is to be trusted, or "". */
export interface Verdict {
  light: string;
  direction: Certainty;
  brightness: Certainty;
  colour: Certainty;
  doubt: string;
}
/** estimate.json, as far as the page reads it, and the preview's camera. */
export interface EstimateResult {
  light: string;
  /** How likely the model is, where open sky and lamps competed. */
  choice: { probability: number } | null;
  sun: Angles;
  /** The strongest first; empty for models without lamps. */
  lamps: MeasuredLamp[];
  /** Where there are lamps. */
  lamp_facts?: LampFacts;
  verdict: Verdict;
  posterior: {
    /** Whether there is a sun or a lamp to see. */
    is_seen: boolean;
    share: number;
    region_radius_deg: number;
    /** Density of posterior.exr along the region's edge. */
    region_edge_per_sr: number;
    region_parts: ({ share: number } & Angles)[];
  };
  advice: string[];
  faces: {
    number: number;
    residual: number;
    albedo: [number, number, number];
    /** The head's own origin, mid-head at the height of the eyes: camera's frame, metres. */
    eyes: [number, number, number];
    /** Where the face looks, a unit vector. */
    forward: [number, number, number];
  }[];
  /** The photo is these gains times what the map shades, edited. */
  white_balance: [number, number, number];
  edit: Edit;
  seconds: Record<string, number>;
  camera: { focal_px: number; width: number; height: number; principal: [number, number] };
}

export class ApiError extends Error {
  constructor(
    message: string,
    readonly status: number,
  ) {
    super(message);
  }
}

const GONE = "the studio does not answer: see whether `skylight studio` still runs, then try again";

/** How long a broken stream may take to come back: longer and the server has cancelled the job. */
const PATIENCE_MS = 5000;
/** How long a stream may be silent: the server tells of every job each 15 s, changed or not. */
const SILENCE_MS = 60_000;

/** fetch, with the server's own line as the error, or one that says that it is gone. */
async function ask(path: string, init?: RequestInit): Promise<Response> {
  let answer: Response;
  try {
    answer = await fetch(path, init);
  } catch (error) {
    if (error instanceof DOMException && error.name === "AbortError") throw error;
    throw new ApiError(GONE, 0);
  }
  if (answer.ok) return answer;
  const body = (await answer.json().catch(() => ({}))) as { error?: string };
  throw new ApiError(body.error ?? `the studio answered ${answer.status}`, answer.status);
}

export async function getJson<T>(path: string): Promise<T> {
  return (await (await ask(path)).json()) as T;
}

export async function getBytes(path: string): Promise<ArrayBuffer> {
  return (await ask(path)).arrayBuffer();
}

export async function getText(path: string): Promise<string> {
  return (await ask(path)).text();
}

let asked: Promise<About> | undefined;
/** GET /api/about, once; asked again after a failure. */
export function about(): Promise<About> {
  asked ??= getJson<About>("/api/about").catch((error: unknown) => {
    asked = undefined;
    throw error;
  });
  return asked;
}

async function upload<T>(where: string, file: File, signal?: AbortSignal): Promise<T> {
  const { limits } = await about();
  if (file.size > limits.upload_mb * 1e6)
    throw new ApiError(`${file.name} is larger than ${limits.upload_mb} MB: save a smaller one`, 413);
  const answer = await ask(`${where}?name=${encodeURIComponent(file.name)}`, {
    method: "POST",
    body: file,
    headers: { "Content-Type": "application/octet-stream" },
    ...(signal && { signal }),
  });
  return (await answer.json()) as T;
}

export const uploadPhoto = (file: File, signal?: AbortSignal): Promise<Photo> =>
  upload("/api/photos", file, signal);
export const uploadMap = (file: File, signal?: AbortSignal): Promise<LightMap> =>
  upload("/api/maps", file, signal);
export const previewUrl = (photo: string): string => `/api/photos/${photo}/preview.jpg`;

export const examples = (): Promise<Example[]> => getJson("/api/examples");
export const exampleUrl = (name: string): string => `/api/examples/${name}.png`;
/** An example as a file, as if it had been chosen. */
export async function exampleFile(name: string): Promise<File> {
  return new File([await getBytes(exampleUrl(name))], `${name}.png`, { type: "image/png" });
}

/** Starts a job and returns its id. */
export async function startJob(request: { kind: string; [key: string]: unknown }): Promise<string> {
  const answer = await ask("/api/jobs", {
    method: "POST",
    body: JSON.stringify(request),
    headers: { "Content-Type": "application/json" },
  });
  return ((await answer.json()) as { job: string }).job;
}

/**
 * Follows a job to its end: `changed` sees every state, the promise its last one, with the result.
 * Aborting closes the stream, which cancels the job on the server. Rejects where the job failed or
 * the server is gone.
 */
export function followJob<Result>(
  id: string,
  changed: (job: Job<Result>) => void,
  signal: AbortSignal,
): Promise<Job<Result>> {
  return new Promise((resolve, reject) => {
    const stream = new EventSource(`/api/jobs/${id}/events`);
    let patience = 0;
    let silence = 0;
    const end = (): void => {
      stream.close();
      clearTimeout(patience);
      clearTimeout(silence);
      signal.removeEventListener("abort", aborted);
    };
    const aborted = (): void => {
      end();
      reject(new DOMException("cancelled", "AbortError"));
    };
    signal.addEventListener("abort", aborted);
    if (signal.aborted) return aborted();
    const gone = (): void => {
      end();
      reject(new ApiError(GONE, 0));
    };
    const heard = (): void => {
      clearTimeout(silence);
      silence = window.setTimeout(gone, SILENCE_MS);
    };
    heard();
    stream.onmessage = (event: MessageEvent<string>) => {
      clearTimeout(patience);
      patience = 0;
      heard();
      const job = JSON.parse(event.data) as Job<Result>;
      changed(job);
      if (job.state === "waiting" || job.state === "running") return;
      end();
      if (job.state === "done") {
        // the stream's last state may leave a large result out
        if (job.result !== undefined) resolve(job);
        else getJson<Job<Result>>(`/api/jobs/${id}`).then(resolve, reject);
      } else if (job.state === "cancelled") reject(new DOMException("cancelled", "AbortError"));
      else reject(new ApiError(job.error ?? "the job failed", 500));
    };
    // a stream that broke is opened again by the browser; it is gone where that does not help
    stream.onerror = () => {
      if (stream.readyState === EventSource.CLOSED) gone();
      else patience ||= window.setTimeout(gone, PATIENCE_MS);
    };
  });
}

/** Cancels a job, or has the server forget it. Silent: whoever leaves needs no answer. */
export function forgetJob(id: string): void {
  void fetch(`/api/jobs/${id}`, { method: "DELETE", keepalive: true }).catch(() => {});
}

/** Has the server forget a photo. Silent, too. */
export function forgetPhoto(photo: string): void {
  void fetch(`/api/photos/${photo}`, { method: "DELETE", keepalive: true }).catch(() => {});
}

export const fileUrl = (job: string, name: string): string =>
  `/api/jobs/${job}/files/${encodeURIComponent(name)}`;
/** A file of an estimate under its lamps as they are now; they are in its order. */
export function lampsUrl(job: string, name: string, lamps: (Angles & { on: boolean })[], ambient: boolean): string {
  const edit = new URLSearchParams({ ambient: String(ambient) });
  for (const { azimuth_deg, zenith_deg, on } of lamps) {
    edit.append("azimuth_deg", String(azimuth_deg));
    edit.append("zenith_deg", String(zenith_deg));
    edit.append("on", String(on));
  }
  return `/api/jobs/${job}/lamps/${name}?${edit}`;
}
export const zipUrl = (job: string): string => `/api/jobs/${job}/files.zip`;

import { followJob, forgetJob, startJob, type Job } from "../api";
import { alertBox } from "./alert";
import { el, freshId } from "./dom";
import { leftInWords, secondsLeft } from "./time_left";

export interface JobPanel {
  element: HTMLElement;
  /**
   * Runs a job to its end, showing its stages; null where it failed (the panel says why) or was
   * cancelled. One at a time: a second call cancels the first.
   */
  run: <Result>(request: { kind: string; [key: string]: unknown }, begun?: (job: string) => void) => Promise<Job<Result> | null>;
  /** The same with a job that was begun before the page was loaded. */
  resume: <Result>(job: string) => Promise<Job<Result> | null>;
  cancel: () => void;
}

/** A job's progress bar, stage, and cancel button, and the line that says why it failed. */
export function jobPanel(): JobPanel {
  const id = freshId("stage");
  const stage = el("p", { id, role: "status", "aria-live": "polite" });
  const bar = el("progress", { max: 1, value: 0, "aria-labelledby": id });
  const button = el("button", { type: "button", onclick: () => cancel() }, "Cancel");
  const left = el("span", { class: "muted small figure left" });
  const working = el("div", { class: "job" }, el("div", { class: "row split" }, stage, button), bar, left);
  const alert = alertBox();
  working.hidden = true;
  let stop: AbortController | null = null;
  let since: number | null = null; // when the studio began with it; null where the time left is not known

  const show = (job: Job): void => {
    if (since !== null) {
      if (job.state === "waiting") since = performance.now();
      left.textContent = leftInWords(secondsLeft(job.stage, job.share, (performance.now() - since) / 1000));
    }
    const jobs = job.before === 1 ? "job" : "jobs";
    const words = job.before ? `${job.before} ${jobs} before yours` : job.stage || "Starting";
    const line = `${words.charAt(0).toUpperCase()}${words.slice(1)} …`;
    if (stage.textContent !== line) stage.textContent = line; // said once, not at every step
    bar.value = job.share;
  };
  const cancel = (): void => {
    stop?.abort();
    stop = null;
    working.hidden = true;
  };
  return {
    element: el("div", { class: "stack tight" }, working, alert.element),
    cancel,
    run: (request, begun) =>
      follow(request.kind === "estimate" ? performance.now() : null, async () => {
        const job = await startJob(request);
        begun?.(job);
        return job;
      }),
    resume: (job) => follow(null, () => Promise.resolve(job)),
  };

  async function follow<Result>(begins: number | null, start: () => Promise<string>): Promise<Job<Result> | null> {
    cancel();
    alert.clear();
    const mine = new AbortController();
    stop = mine;
    stage.textContent = "Starting …";
    left.textContent = "";
    bar.removeAttribute("value");
    working.hidden = false;
    since = begins;
    let job = "";
    try {
      job = await start();
      return await followJob<Result>(job, show, mine.signal);
    } catch (error) {
      if (job) forgetJob(job);
      if (!mine.signal.aborted) alert.show(error);
      return null;
    } finally {
      if (stop === mine) cancel();
    }
  }
}

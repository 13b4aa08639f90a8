interface Step {
  before: string;
  after: string;
  apply: (to: string) => void;
}

/** Until a movement counts as one change, that is taken back at once. */
const SETTLED_MS = 400;
const MOST = 100;

/**
 * Changes of light and objects, taken back and made again one by one. What is watched are states
 * that JSON can write; `saved` gets those as they are now, by name, to be given as `kept` to
 * another history.
 */
export class History {
  private readonly done: Step[] = [];
  private readonly undone: Step[] = [];
  private readonly settle: (() => void)[] = [];
  private readonly now: Record<string, string>;

  constructor(
    kept: Record<string, string>,
    private readonly saved: (now: Record<string, string>) => void,
    /** Whether there is something to take back, and to make again. */
    private readonly offers: (undo: boolean, redo: boolean) => void,
  ) {
    this.now = { ...kept };
  }

  /**
   * Returns what is to be called after each change of a state. Where an earlier one was kept under
   * that name, it is set; `bring` brings into sight what is taken back or made again.
   */
  watch<State>(name: string, get: () => State, set: (to: State) => void, bring: () => void): () => void {
    let timer = 0;
    const first = JSON.stringify(get());
    const kept = this.now[name];
    let last = first;
    const commit = (): void => {
      clearTimeout(timer);
      const to = JSON.stringify(get());
      if (to === last) return;
      this.done.push({ before: last, after: to, apply: (state) => (apply(state), bring()) });
      if (this.done.length > MOST) this.done.shift();
      this.undone.length = 0;
      this.note(name, (last = to));
    };
    const apply = (to: string): void => {
      last = to;
      set(JSON.parse(to) as State);
      last = JSON.stringify(get()); // as far as it could be set
      this.note(name, last);
    };
    this.settle.push(commit);
    if (kept !== undefined && kept !== first) apply(kept);
    return () => {
      clearTimeout(timer);
      timer = window.setTimeout(commit, SETTLED_MS);
    };
  }

  undo(): void {
    for (const commit of this.settle) commit();
    const step = this.done.pop();
    if (!step) return;
    this.undone.push(step);
    step.apply(step.before);
  }

  redo(): void {
    for (const commit of this.settle) commit();
    const step = this.undone.pop();
    if (!step) return;
    this.done.push(step);
    step.apply(step.after);
  }

  private note(name: string, state: string): void {
    this.now[name] = state;
    this.saved(this.now);
    this.offers(this.done.length > 0, this.undone.length > 0);
  }
}

/** Ctrl-Z, and Ctrl-Y or Ctrl-Shift-Z, but where text is typed; returns what to call at the end. */
export function historyKeys(history: () => History | null): () => void {
  const pressed = (event: KeyboardEvent): void => {
    const key = event.key.toLowerCase();
    if (!(event.ctrlKey || event.metaKey) || event.altKey || !["z", "y"].includes(key)) return;
    const typed = event.target as HTMLElement;
    if (typed.matches("input[type=number], input[type=text], textarea") || !history()) return;
    event.preventDefault();
    if (key === "y" || event.shiftKey) history()!.redo();
    else history()!.undo();
  };
  document.addEventListener("keydown", pressed);
  return () => document.removeEventListener("keydown", pressed);
}

/**
 * Does `work` for the newest value, one at a time: what comes while it works waits, and is
 * forgotten when something newer comes. `work` handles its own failures.
 */
export function newest<T>(work: (value: T) => Promise<void>): (value: T) => void {
  let next: T | undefined;
  let isBusy = false;
  const go = async (): Promise<void> => {
    isBusy = true;
    while (next !== undefined) {
      const value = next;
      next = undefined;
      await work(value);
    }
    isBusy = false;
  };
  return (value) => {
    next = value;
    if (!isBusy) void go();
  };
}

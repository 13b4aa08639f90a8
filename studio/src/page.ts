/** Fills the given element; returns what to call when the user leaves the page. */
export type Page = (root: HTMLElement) => () => void;

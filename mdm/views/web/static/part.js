// A part of the page. What fails in it leaves the others as they are; it is tried again, and told of once.
import { html, useEffect, useErrorBoundary } from "./vendor/htm-preact.js";

const AGAIN = 1000;   // Milliseconds until a part that has failed is drawn anew.
const told = new Set();

export function Part({ name, children }) {
  const [failed, again] = useErrorBoundary((error) => {
    if (!told.has(error.message)) reportError(error);
    told.add(error.message);
  });
  useEffect(() => {
    if (!failed) return undefined;
    const timer = setTimeout(again, AGAIN);
    return () => clearTimeout(timer);
  }, [failed]);
  // A box of another key: what was drawn by half goes with the box that it was in.
  if (!failed) return html`<div class="part" key="whole">${children}</div>`;
  return html`<div class="part" key="failed"><section class="panel wide"><p class="said refused">✕ ${name} cannot be drawn: ${failed.message}</p></section></div>`;
}

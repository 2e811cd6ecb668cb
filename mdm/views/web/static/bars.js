// Bars: of a share, of a probability that changes, and of how often something came, over a logarithmic axis.
import { html } from "./vendor/htm-preact.js";
import { percent } from "./words.js";

export function Bar({ label, share, text, rest }) {
  return html`<div class="bar"><span class="label" title=${label}>${label}</span>
    <span class="track" aria-hidden="true"><span class=${`fill${rest ? " rest" : ""}`} style=${`display:block;width:${Math.max(0, Math.min(1, share)) * 100}%`}></span></span>
    <span class="value number">${text}</span></div>`;
}

// A probability as a bar; with another one after a change, an arrow leads there.
export function Share({ name, share, after }) {
  const [from, to] = [100 * share, 100 * (after ?? share)];
  return html`<div class="bar"><span class="label" title=${name}>${name}</span>
    <span class="track axis" aria-hidden="true"><span class="fill" style=${`left:0;width:${from}%`}></span>
      ${after != null && html`<span class=${`arrow ${to < from ? "back" : ""}`} style=${`left:${Math.min(from, to)}%;width:${Math.max(Math.abs(to - from), 1)}%`}></span>`}</span>
    <span class="value number">${percent(share)}${after == null ? "" : ` → ${percent(after)}`}</span></div>`;
}

const TICKS = 6;

// Args: bins: from where to where each reaches, how high it is, and what it says; format: of the values on the axis.
export function Histogram({ bins, format, label }) {
  const [least, greatest] = [bins[0][0], bins[bins.length - 1][1]], wider = greatest / least < 8 ? 2 : 1;   // so that a tick is in sight
  const low = Math.log10(least / wider), high = Math.log10(greatest * wider), most = Math.max(...bins.map(([, , height]) => height));
  const at = (value) => (100 * (Math.log10(value) - low)) / (high - low || 1);
  const decades = [];
  for (let power = Math.floor(low); power <= high; power += 1) decades.push(power);
  const few = decades.length <= 3 ? [1, 2, 5] : [1], every = Math.ceil(decades.length / TICKS);
  const ticks = decades.filter((_, place) => place % every === 0).flatMap((power) => few.map((times) => times * 10 ** power)).filter((value) => at(value) >= -0.1 && at(value) <= 100.1);
  return html`<div class="histogram" role="img" aria-label=${label}><div class="bins">
    ${bins.map(([from, to, height, text]) => html`<span key=${to} style=${`left:${at(from)}%;width:${at(to) - at(from)}%;height:${Math.max(2, (100 * height) / most)}%`} title=${text}></span>`)}</div>
    <div class="ticks number soft">${ticks.map((value) => html`<span key=${value} style=${`left:${at(value)}%`}>${format(value)}</span>`)}</div></div>`;
}

// Over time: the belief as a band, and the expected reward as a line.
import { html, useEffect, useRef } from "./vendor/htm-preact.js";
import { colour } from "./words.js";

const STATES = 5, KEPT = 600;
const GAP = 2;   // Seconds without the decisions between, from which on no line is drawn.

// What was seen of one ensemble's belief and reward since it was chosen.
export class Seen {
  constructor() { this.path = null; this.clear(); }

  clear() { this.times = []; this.beliefs = []; this.rewards = []; }

  add(path, frame, epoch) {
    if (path !== this.path) { this.path = path; this.clear(); }
    const detail = frame.details?.[path];
    if (!detail || detail.decided == null) return;
    const last = this.times[this.times.length - 1];
    if (last != null && detail.decided < last) this.clear();
    if (detail.decided === last) return;
    if (last != null && epoch > this.epoch + 1 && detail.decided > last + GAP) {
      this.times.push(last + GAP / 1000);   // what came between has not been seen
      this.beliefs.push(null);
      this.rewards.push(null);
    }
    this.epoch = epoch;
    this.times.push(detail.decided);
    this.beliefs.push(detail.belief ? new Map(detail.belief.top) : null);
    this.rewards.push(detail.reward ?? null);
    if (this.times.length > KEPT) for (const list of [this.times, this.beliefs, this.rewards]) list.splice(0, 100);
  }

  // Times, the names of the likeliest states, and a list of probabilities for each of these and for the rest.
  bands() {
    const sums = new Map();
    for (const each of this.beliefs) for (const [state, chance] of each ?? []) sums.set(state, (sums.get(state) ?? 0) + chance);
    const names = [...sums].sort((one, two) => two[1] - one[1]).slice(0, STATES).map(([state]) => state);
    const lists = names.map((state) => this.beliefs.map((each) => (each ? each.get(state) ?? 0 : null)));
    return { names, lists };
  }
}

function plot(box, data, options) {
  return new window.uPlot({ width: Math.max(200, box.clientWidth), height: 130, cursor: { show: true, drag: { x: false } }, legend: { show: true, live: false },
    scales: { x: { time: false } }, ...options }, data, box);
}

const axes = () => [
  { stroke: colour("soft"), grid: { stroke: colour("line"), width: 1 }, ticks: { stroke: colour("line") }, values: (_, all) => all.map((each) => `${each} s`) },
  { stroke: colour("soft"), grid: { stroke: colour("line"), width: 1 }, ticks: { stroke: colour("line") }, size: 46 },
];

export function Plots({ seen, path, scheme }) {
  const belief = useRef(null), reward = useRef(null);
  const believes = seen.path === path && seen.beliefs.some((each) => each);
  const rewarded = seen.path === path && seen.rewards.filter((each) => each != null).length > 1;
  const length = seen.times.length;
  useEffect(() => {
    if (!belief.current || !believes || length < 2) return undefined;
    const { names, lists } = seen.bands();
    const sums = [];
    lists.forEach((list, place) => sums.push(list.map((value, index) => (value == null ? null : value + (place ? sums[place - 1][index] : 0)))));
    const series = names.map((state, place) => ({ label: `${place + 1} ${state}`, stroke: colour(`s${place}`), width: 1.5,
      fill: `color-mix(in srgb, ${colour(`s${place}`)} 35%, ${colour("paper")})`, dash: [[], [8, 3], [2, 3], [10, 3, 2, 3], [4, 4]][place], paths: window.uPlot.paths.stepped({ align: 1 }) }));
    // The highest line first, so that those below are drawn over it.
    const made = plot(belief.current, [seen.times, ...sums.reverse()], { scales: { x: { time: false }, y: { range: [0, 1] } }, axes: axes(), series: [{}, ...series.reverse()] });
    return () => made.destroy();
  }, [path, length, scheme, believes]);
  useEffect(() => {
    if (!reward.current || !rewarded) return undefined;
    const made = plot(reward.current, [seen.times, seen.rewards], { axes: axes(), series: [{}, { label: "expected reward", stroke: colour("s0"), width: 2, paths: window.uPlot.paths.stepped({ align: 1 }), points: { show: true, size: 5 } }] });
    return () => made.destroy();
  }, [path, length, scheme, rewarded]);
  if (!believes && !rewarded) return null;
  return html`<section class="panel" aria-label="Over time"><h2>Over time: ${path}</h2>
    ${believes && html`<div><h3>belief, its likeliest states, stacked</h3><p class="soft legend">Each band is as wide as its state is likely; all together come to 1; what is above the bands is the rest.</p><div class="chart" ref=${belief} role="img" aria-label="Belief over time, a band for each state, one on top of the other"></div></div>`}
    ${rewarded && html`<div><h3>expected reward</h3><div class="chart" ref=${reward} role="img" aria-label="Expected reward over time"></div></div>`}
  </section>`;
}

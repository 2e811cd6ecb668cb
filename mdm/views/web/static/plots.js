// Over time: the belief as a band, and expected reward and return as lines.
import { html, useEffect, useRef } from "./vendor/htm-preact.js";
import { Panel } from "./panel.js";
import { clock, colour, digits, edge, stateTint } from "./words.js";

const STATES = 5, KEPT = 600;
const GAP = 2;   // Seconds without the decisions between, from which on no line is drawn.
const DOTS = 60;   // Decisions up to which each has a dot.

// What was seen of one ensemble's decisions since it was chosen, in a running system, which keeps no past.
export class Seen {
  constructor() { this.path = null; this.clear(); }

  clear() { this.made = null; this.times = []; this.tops = []; this.rewards = []; this.values = []; }

  lists() { return [this.times, this.tops, this.rewards, this.values]; }

  add(path, frame, epoch) {
    if (path !== this.path) { this.path = path; this.clear(); }
    const detail = frame.details?.[path];
    if (!detail || detail.decided == null) return;
    const last = this.times[this.times.length - 1];
    if (last != null && detail.decided < last) this.clear();
    if (detail.decided === last) return;
    const put = (...entry) => this.lists().forEach((list, place) => list.push(entry[place]));
    if (last != null && epoch > this.epoch + 1 && detail.decided > last + GAP) put(last + GAP / 1000, null, null, null);   // what came between has not been seen
    this.epoch = epoch;
    this.made = null;
    put(detail.decided, detail.belief ? new Map(detail.belief.top) : null, detail.reward ?? null, detail.value ?? null);
    if (this.times.length > KEPT) for (const list of this.lists()) list.splice(0, 100);
  }

  // The same shape as the course of a record.
  course() {
    if (this.made) return this.made;
    const sums = new Map();
    for (const each of this.tops) for (const [state, chance] of each ?? []) sums.set(state, (sums.get(state) ?? 0) + chance);
    const states = [...sums].sort((one, two) => two[1] - one[1]).slice(0, STATES).map(([state]) => state);
    const beliefs = states.map((state) => this.tops.map((each) => (each ? each.get(state) ?? 0 : null)));
    return this.made = { times: this.times, decisions: this.times.length, states, beliefs, rewards: this.rewards, values: this.values };
  }
}

// A chart over some time, with a line at the moment that is shown, which a click moves.
function plot(box, data, { now, range, go, ...options }) {
  const mark = (chart) => {
    const at = chart.valToPos(now.current, "x", true);
    if (!go || at < chart.bbox.left || at > chart.bbox.left + chart.bbox.width) return;
    chart.ctx.fillStyle = colour("mark");
    chart.ctx.fillRect(at - 1, chart.bbox.top, 2, chart.bbox.height);
  };
  const made = new window.uPlot({ width: Math.max(200, box.clientWidth), height: 130, cursor: { show: true, drag: { x: false } }, legend: { show: true, live: false },
    ...options, scales: { ...options.scales, x: { time: false, ...(range ? { range } : {}) } }, hooks: { draw: [mark] } }, data, box);
  if (go) made.over.addEventListener("click", () => go(made.posToVal(made.cursor.left, "x")));
  return made;
}

const axes = () => [
  { stroke: colour("soft"), grid: { stroke: colour("line"), width: 1 }, ticks: { stroke: colour("line") }, space: 80, values: (_, all, __, ___, step) => all.map((each) => clock(each, digits(step))) },
  { stroke: colour("soft"), grid: { stroke: colour("line"), width: 1 }, ticks: { stroke: colour("line") }, size: 46 },
];

const steps = () => window.uPlot.paths.stepped({ align: 1 });
const some = (list) => list.filter((each) => each != null).length > 0;

// A drawing that is made anew when what it shows changes, and has its line moved when time does.
function Drawing({ make, of, label, now }) {
  const box = useRef(null), made = useRef(null);
  useEffect(() => {
    made.current = make(box.current);
    return () => made.current.destroy();
  }, of);
  useEffect(() => { made.current.redraw(false); }, [now]);
  return html`<div class="chart" ref=${box} role="img" aria-label=${label}></div>`;
}

// Args: course: what is drawn; version: another one for each other course; range: of a record, its first and last second.
export function Plots({ course, version, path, time, range, go, scheme }) {
  const now = useRef(time);
  now.current = time;
  if (!course || course.times.length < 2) return null;
  const believes = course.states.length > 0;
  // The last decision holds to the end.
  const until = range && range[1] > course.times[course.times.length - 1] ? [range[1]] : [];
  const times = [...course.times, ...until];
  const whole = (list) => [...list, ...until.map(() => list[list.length - 1])];
  const of = [path, version, scheme];
  const options = { now, range, go, axes: axes() };
  const bands = (box) => {
    const sums = [];
    course.beliefs.map(whole).forEach((list, place) => sums.push(list.map((value, index) => (value == null ? null : value + (place ? sums[place - 1][index] : 0)))));
    const series = course.states.map((state, place) => ({ label: `${place + 1} ${state}`, stroke: edge(stateTint(place)), width: 1.5,
      fill: colour(stateTint(place)), dash: [[], [8, 3], [2, 3], [10, 3, 2, 3], [4, 4]][place], paths: steps(), points: { show: false } }));
    // The highest line first, so that those below are drawn over it.
    return plot(box, [times, ...sums.reverse()], { ...options, scales: { y: { range: [0, 1] } }, series: [{}, ...series.reverse()] });
  };
  const line = (label, list) => (box) => plot(box, [times, whole(list)],
    { ...options, series: [{}, { label, stroke: colour("mark"), width: 2, paths: steps(), points: { show: course.times.length <= DOTS, size: 5 } }] });
  const lines = [["expected reward", course.rewards], ["expected return", course.values]].filter(([, list]) => some(list));
  if (!believes && !lines.length) return null;
  return html`<${Panel} name="Over time" title=${`Over time: ${path}`}>
    ${course.decisions > course.times.length && html`<p class="soft legend number">${course.times.length.toLocaleString("en")} of ${course.decisions.toLocaleString("en")} decisions are drawn, the last one of each part of the time; where the timeline is zoomed in, there are more.</p>`}
    ${believes && html`<div><h3>belief, its likeliest states, stacked</h3><p class="soft legend">Each band is as wide as its state is likely; all together come to 1; what is above the bands is the rest.</p>
      <${Drawing} key="belief" make=${bands} of=${of} now=${go && time} label="Belief over time, a band for each state, one on top of the other" /></div>`}
    ${lines.map(([label, list]) => html`<div key=${label}><h3>${label}</h3><${Drawing} make=${line(label, list)} of=${of} now=${go && time} label=${`${label[0].toUpperCase()}${label.slice(1)} over time`} /></div>`)}
  <//>`;
}

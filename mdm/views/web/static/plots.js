// Over time: the belief as a band, and expected reward and return as lines.
import { html, useEffect, useRef, useState } from "./vendor/htm-preact.js";
import { Panel } from "./panel.js";
import { clock, colour, digits, edge, stateTint } from "./words.js";

const STATES = 5, KEPT = 600;
const GAP = 2;   // Seconds without the decisions between, from which on no line is drawn.
const SHARES = 24;   // Values of factors of which each can be drawn.
const BAND = 0.2;   // The share of the belief that the states with bands have to have together.
const DOTS = 60;   // Decisions up to which each has a dot.

const LISTS = ["times", "tops", "rewards", "values", "entropies", "shares", "latencies"];

// What was seen of one ensemble's decisions since it was chosen, in a running system, which keeps no past.
export class Seen {
  constructor() { this.path = null; this.clear(); }

  clear() { this.made = null; for (const list of LISTS) this[list] = []; }

  add(path, frame, epoch) {
    if (path !== this.path) { this.path = path; this.clear(); }
    const detail = frame.details?.[path], belief = detail?.belief;
    if (!detail || detail.decided == null) return;
    const last = this.times[this.times.length - 1];
    if (last != null && detail.decided < last) this.clear();
    if (detail.decided === last) return;
    const put = (entry) => LISTS.forEach((list) => this[list].push(entry[list] ?? null));
    if (last != null && epoch > this.epoch + 1 && detail.decided > last + GAP) put({ times: last + GAP / 1000 });   // what came between has not been seen
    this.epoch = epoch;
    this.made = null;
    put({ times: detail.decided, tops: belief && new Map(belief.top), rewards: detail.reward, values: detail.value, entropies: belief && (belief.entropy ?? 0),
      shares: belief && Object.fromEntries((belief.marginals ?? []).flatMap((each) => each.symbols.map((symbol, place) => [`${each.factor} ${symbol}`, each.values[place]]))),
      latencies: frame.statistics?.latencies?.[path]?.half });
    if (this.times.length > KEPT) for (const list of LISTS) this[list].splice(0, 100);
  }

  // The same shape as the course of a record.
  course() {
    if (this.made) return this.made;
    const sums = new Map();
    for (const each of this.tops) for (const [state, chance] of each ?? []) sums.set(state, (sums.get(state) ?? 0) + chance);
    const states = [...sums].sort((one, two) => two[1] - one[1]).slice(0, STATES).map(([state]) => state);
    const beliefs = states.map((state) => this.tops.map((each) => (each ? each.get(state) ?? 0 : null)));
    const names = new Set(this.shares.slice(-1).flatMap((each) => Object.keys(each ?? {})).slice(0, SHARES));
    const shares = [...names].map((name) => [name, this.shares.map((each) => each?.[name] ?? null)]);
    return this.made = { times: this.times, decisions: this.times.length, states, beliefs, rewards: this.rewards, values: this.values, entropies: this.entropies, shares, latencies: this.latencies };
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
  { stroke: colour("soft"), grid: { stroke: colour("line"), width: 1 }, ticks: { stroke: colour("line") }, space: 80, size: 34, values: (_, all, __, ___, step) => all.map((each) => clock(each, digits(step))) },
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

const KEY = "plots", FIRST = ["belief", "expected reward", "expected return"];
function chosenOnes() {
  try { return JSON.parse(localStorage.getItem(KEY)) ?? FIRST; } catch { return FIRST; }
}

// The signals that can be drawn by their names: times, values, and the text of a value where that is not its number.
function signalsOf(course, predicates, range) {
  const found = new Map();
  const put = (name, values, more) => { if (some(values ?? [])) found.set(name, { times: course.times, values, ...more }); };
  if (course?.times.length > 1) {
    const mean = course.beliefs.reduce((sum, list) => sum + list.reduce((all, each) => all + (each ?? 0), 0), 0) / course.times.length;
    if (course.states.length && mean > BAND) found.set("belief", { times: course.times, values: course.beliefs });
    put("expected reward", course.rewards);
    put("expected return", course.values);
    put("states in doubt", course.entropies?.map((each) => (each == null ? null : 2 ** each)), { about: "How many equally likely states would be as unsure; 1 is certain." });
    for (const [name, values] of course.shares ?? []) put(`probability of ${name}`, values, { span: [0, 1] });
    if (course.states.length && !course.shares?.length) course.states.forEach((state, place) => put(`probability of ${state}`, course.beliefs[place], { span: [0, 1] }));
    put("latency, half within", course.latencies?.map((each) => (each == null ? null : 1e3 * each)), { about: "Milliseconds from stimulus to callback." });
  }
  for (const [name, changes] of predicates) {
    const last = range?.[1] ?? course?.times[course.times.length - 1], end = last > changes[changes.length - 1]?.time ? [last] : [];
    const values = changes.map(({ status }) => ({ true: 1, false: 0 })[status] ?? null);
    if (changes.length) found.set(`predicate ${name}`, { times: [...changes.map(({ time }) => time), ...end], values: [...values, ...end.map(() => values[values.length - 1])], span: [-0.05, 1.05], about: "1 is true, 0 is false." });
  }
  return found;
}

// Args: course: what is drawn; version: another one for each other course; predicates: their changes by name; range: of a record, its first and last second.
export function Plots({ course, version, predicates, path, time, range, go, scheme }) {
  const now = useRef(time);
  const [chosen, choose] = useState(chosenOnes);
  now.current = time;
  const signals = signalsOf(course, predicates, range);
  if (!signals.size) return null;
  const keep = (names) => { localStorage.setItem(KEY, JSON.stringify(names)); choose(names); };
  const options = { now, range, go, axes: axes() };
  // The last decision holds to the end.
  const whole = (times, list) => (range && range[1] > times[times.length - 1] ? [...list, list === times ? range[1] : list[list.length - 1]] : list);
  const bands = ({ times, values }) => (box) => {
    const sums = [];
    values.map((list) => whole(times, list)).forEach((list, place) => sums.push(list.map((value, index) => (value == null ? null : value + (place ? sums[place - 1][index] : 0)))));
    const series = course.states.map((state, place) => ({ label: state, stroke: edge(stateTint(place)), width: 1.5,
      fill: colour(stateTint(place)), dash: [[], [8, 3], [2, 3], [10, 3, 2, 3], [4, 4]][place], paths: steps(), points: { show: false } }));
    // The highest line first, so that those below are drawn over it.
    return plot(box, [whole(times, times), ...sums.reverse()], { ...options, scales: { y: { range: [0, 1] } }, series: [{}, ...series.reverse()] });
  };
  const line = ({ times, values, span }) => (box) => plot(box, [whole(times, times), whole(times, values)],
    { ...options, legend: { show: false }, ...(span ? { scales: { y: { range: span } } } : {}), series: [{}, { stroke: colour("mark"), width: 2, paths: steps(), points: { show: times.length <= DOTS, size: 5 } }] });
  const shown = chosen.filter((name) => signals.has(name)), others = [...signals.keys()].filter((name) => !chosen.includes(name));
  const title = { belief: "belief, its likeliest states, stacked" };
  const about = (name) => (name === "belief" ? "Each band is as wide as its state is likely; above the bands is the rest." : signals.get(name).about);
  return html`<${Panel} name="Over time" title=${`Over time: ${path}`} aside=${others.length > 0 && html`<select aria-label="Draw a signal" value="" onChange=${(event) => { keep([...chosen, event.currentTarget.value]); event.currentTarget.value = ""; }}>
      <option value="">draw…</option>${others.map((name) => html`<option key=${name} value=${name}>${name}</option>`)}</select>`}>
    ${course?.decisions > course?.times.length && html`<p class="soft legend number">${course.times.length.toLocaleString("en")} of ${course.decisions.toLocaleString("en")} decisions are drawn, the last one of each part of the time; where the timeline is zoomed in, there are more.</p>`}
    ${shown.map((name) => html`<div class="signal" key=${name}><div class="head"><h3>${title[name] ?? name}</h3><button class="fold" aria-label=${`Draw ${name} no more`} onClick=${() => keep(chosen.filter((each) => each !== name))}>×</button></div>
      ${about(name) && html`<p class="soft legend">${about(name)}</p>`}
      <${Drawing} make=${(name === "belief" ? bands : line)(signals.get(name))} of=${[path, version, scheme, signals.get(name).times.length]} now=${go && time} label=${name === "belief" ? "Belief over time, a band for each state, one on top of the other" : `${name[0].toUpperCase()}${name.slice(1)} over time`} /></div>`)}
    ${!shown.length && html`<p class="empty">Choose above what is drawn.</p>`}
  <//>`;
}

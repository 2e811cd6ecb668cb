// The timeline: a lane an ensemble, with modes, lives of actions and decisions; below them predicates; faults above. It
// zooms and scrolls, and tells of all that is in it.
import { html, useEffect, useRef, useState } from "./vendor/htm-preact.js";
import { Panel } from "./panel.js";
import { called, clock, colour, digits, edge, feeding, seconds, SIGNS, tint as tinted } from "./words.js";

const LANE = 46, THIN = 18, HEAD = 24, LEFT = 118, MOST = 10, PREDICATES = 8, ACTIONS = 16;
const NEAR = 14;   // Pixels between equal decisions up to which they are drawn as one.
const TINTS = { deciding: "good", safe: "bad", stopped: "off" };

// What happened, by ensemble, in the order of time. Of a running system it is kept event by event, as far as there is room;
// of a record the faults and judgements are, and the rest is what was asked for: some time of some lanes.
export class History {
  constructor() { this.room = {}; this.clear(); }

  clear() {
    this.faults = [];
    this.lanes = new Map();
    this.predicates = new Map();
    this.kept = {};      // Of a kind of event: since when all of them are here, where earlier ones are not.
    this.asked = null;   // Of a record, what the lanes show, and whether any of it stands together.
    this.thinned = false;
  }

  // Show the lanes of a record that were asked for.
  show({ lanes, asked }) {
    for (const lane of this.lanes.values()) Object.assign(lane, { modes: [], lives: [], open: new Map(), decisions: [] });
    this.predicates = new Map();
    for (const event of lanes) this.add(event);
    this.asked = asked;
    this.thinned = lanes.some((each) => each.count > 1);
  }

  // Forget the oldest events of a kind where there are more than the server keeps, or sends.
  trim(list, kind, time = (each) => each.time) {
    const room = this.room[kind] ?? Infinity;
    if (list.length <= 1.25 * room) return;
    list.splice(0, list.length - room);
    this.kept[kind] = Math.max(this.kept[kind] ?? 0, time(list[0]));
  }

  lane(path) {
    if (!this.lanes.has(path)) this.lanes.set(path, { modes: [], lives: [], open: new Map(), decisions: [], judged: [], doubts: new Map() });
    return this.lanes.get(path);
  }

  add(event) {
    if (event.kind === "fault") {
      this.faults.push(event);
      this.trim(this.faults, "fault");
      return;
    }
    if (event.kind === "predicate") {
      if (!this.predicates.has(event.name)) this.predicates.set(event.name, []);
      const changes = this.predicates.get(event.name);
      changes.push(event);
      this.trim(changes, "predicate");
      return;
    }
    const lane = this.lane(event.source);
    if (event.kind === "mode") lane.modes.push(event);
    else if (event.kind === "decision") lane.decisions.push(event);
    else if (event.kind === "judgement" && event.status === "begins") {
      const spell = { from: event.time, to: null, name: event.name, text: event.detail };
      lane.judged.push(spell);
      lane.doubts.set(event.life, spell);
    } else if (event.kind === "judgement") {
      const spell = lane.doubts.get(event.life);
      if (spell) { spell.to = event.time; lane.doubts.delete(event.life); }
    }
    else if (event.kind === "life") {
      if (event.status === "running") {
        const life = { from: event.time, to: null, action: event.name, status: "running", detail: "", count: event.count ?? 1 };
        lane.lives.push(life);
        lane.open.set(event.life, life);
      } else {
        const life = lane.open.get(event.life);
        if (life) { life.to = event.time; life.status = event.status; life.detail = event.detail ?? ""; lane.open.delete(event.life); }
        else lane.lives.push({ from: event.time, to: event.time, action: event.name, status: event.status, detail: event.detail ?? "", count: 1 });
      }
    }
    this.trim(lane.modes, "mode");
    this.trim(lane.lives, "life", (each) => each.from);
    this.trim(lane.decisions, "decision");
  }
}

// The first place in a list that is at a time or later.
function from(list, time, key) {
  let low = 0, high = list.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (key(list[middle]) < time) low = middle + 1; else high = middle;
  }
  return low;
}

export function lanesOf(scene, selected) {
  const paths = scene.ensembles.map((each) => each.path);
  if (paths.length <= MOST) return paths;
  const place = Math.max(0, paths.indexOf(selected));
  const start = Math.max(0, Math.min(place - 2, paths.length - MOST));
  return paths.slice(start, start + MOST);
}

// The predicates that have lanes: those that the chosen ensemble decides on, or all where they are few.
export function shownPredicates(scene, selected) {
  const fed = feeding(scene, scene.ensembles.find((each) => each.path === selected));
  const places = fed.length ? fed : scene.predicates.length <= PREDICATES ? scene.predicates.map((_, place) => place) : [];
  return places.slice(0, PREDICATES).map((place) => scene.predicates[place].name);
}

const told = (event) => `${event.name}, decision ${event.life ?? 0}${event.detail ? `, ${event.detail}` : ""}${event.at ? `\n${event.at}` : ""}`;

const counted = (list, word) => `${list.length} ${word}${list.length === 1 ? "" : "s"}`;
const blamed = (fault) => `⚠ ${clock(fault.time)} ${fault.name}, ${fault.source}: ${fault.detail}${fault.remedy ? `\n→ ${fault.remedy}` : ""}`;

// The faults of a time, in words.
function faultsAt(history, time) {
  const place = from(history.faults, time - 1e-5, (each) => each.time);
  return history.faults.slice(place, place + 3).filter((each) => each.time <= time + 1e-5).map((each) => html`<br />${blamed(each).replace("\n", " ")}`);
}

// What is asked for of a record's lanes, so that they are as fine as the screen; null where they are so already.
export function wantedLanes(scene, history, selected, [first, last], wide) {
  const span = last - first, { asked } = history;
  const about = { paths: lanesOf(scene, selected), predicates: shownPredicates(scene, selected) };
  const same = asked && JSON.stringify([asked.paths, asked.predicates, asked.scene]) === JSON.stringify([about.paths, about.predicates, scene.predicates.length]);
  if (same && asked.whole) return null;
  if (same && asked.first <= first && last <= asked.last && (!history.thinned || asked.last - asked.first < 4 * span)) return null;
  const most = Math.max(100, Math.min(scene.room?.part ?? 1000, Math.round(wide)));
  return { first: Math.max(scene.first, first - span / 2), last: Math.min(scene.last, last + span / 2), ...about, most };
}

// The last decision of an ensemble by a time, in words.
function decision(history, scene, frame, path) {
  const { decisions } = history.lane(path), { time } = frame, detail = frame.details?.[path];
  const place = from(decisions, time + 1e-6, (each) => each.time) - 1;
  const now = frame.ensembles[scene.ensembles.findIndex((each) => each.path === path)];
  const isWhole = place >= 0 && !(decisions[place].count > 1);
  if (scene.source === "record" && !isWhole && detail?.decided != null && now) return `${clock(detail.decided)} ${path} decided ${told({ name: now.action, life: now.epoch, detail: detail.cause })}`;
  return place < 0 ? "" : `${clock(decisions[place].time)} ${path} decided ${told(decisions[place]).replace("\n", ", ")}`;
}

export function Timeline({ scene, frame, history, selected, view, setView, choose, go, scheme, extent }) {
  const box = useRef(null);
  const drag = useRef(null);
  const hits = useRef([]);
  const [tip, show] = useState(null);
  const lanes = lanesOf(scene, selected), predicates = shownPredicates(scene, selected);
  const courses = predicates.map((name) => changesOf(scene, frame, history, name));
  const legend = [...new Map(lanes.flatMap((path) => (scene.ensembles.find((each) => each.path === path)?.actions ?? []).map((name) => [`${tinted(scene, path, name)} ${name}`, [tinted(scene, path, name), name]]))).values()].slice(0, ACTIONS);
  const [first, last] = extent;
  const span = view.span;
  const end = view.follow ? frame.time : view.end;
  const begin = end - span;
  const middle = go && begin <= frame.time && frame.time <= end ? frame.time : (begin + end) / 2;   // of a record the time that is shown
  useEffect(() => { hits.current = draw(box.current, { scene, frame, history, lanes, predicates, courses, selected, begin, end, last }) ?? []; });
  const timeAt = (event) => {
    const { left, width } = box.current.getBoundingClientRect();
    return begin + (Math.max(0, event.clientX - left - LEFT) / Math.max(1, width - LEFT)) * span;
  };
  const zoom = (factor, about) => {
    const wide = Math.max(0.05, Math.min(Math.max(10, (last - first) * 1.2), span * factor));
    if (view.follow && about == null) return setView({ ...view, span: wide });
    const at = about ?? middle;
    setView({ follow: false, span: wide, end: at + ((end - at) / span) * wide });
  };
  useEffect(() => {
    const canvas = box.current;
    if (!canvas) return undefined;   // The panel is closed.
    const wheel = (event) => {
      if (!event.ctrlKey && !event.shiftKey && Math.abs(event.deltaX) < Math.abs(event.deltaY) && !canvas.matches(":focus")) return;
      event.preventDefault();
      if (event.shiftKey || Math.abs(event.deltaX) > Math.abs(event.deltaY)) setView({ follow: false, span, end: end + ((event.deltaX || event.deltaY) / canvas.clientWidth) * span });
      else zoom(event.deltaY > 0 ? 1.25 : 0.8, timeAt(event));
    };
    canvas.addEventListener("wheel", wheel, { passive: false });
    return () => canvas.removeEventListener("wheel", wheel);
  });
  // The ensemble whose name the pointer is on; "" beside the names of ensembles, and null where time is.
  const name = (event) => {
    const { left, top } = box.current.getBoundingClientRect();
    return event.clientX - left >= LEFT ? null : lanes[Math.floor((event.clientY - top - HEAD) / LANE)] ?? "";
  };
  const down = (event) => { drag.current = { x: event.clientX, end, moved: false }; event.currentTarget.setPointerCapture(event.pointerId); };
  const point = (event) => {
    const { left, top, width } = box.current.getBoundingClientRect();
    const x = event.clientX - left, y = event.clientY - top;
    const found = hits.current.findLast((each) => each.left - 3 <= x && x <= each.right + 3 && each.top <= y && y <= each.bottom);
    show(found ? { x: Math.min(x, Math.max(0, width - 280)), y: y + 18, text: found.text } : null);
  };
  const move = (event) => {
    if (!drag.current) { box.current.style.cursor = name(event) ? "pointer" : ""; point(event); return; }
    show(null);
    const by = event.clientX - drag.current.x;
    if (Math.abs(by) > 4) drag.current.moved = true;
    if (drag.current.moved) setView({ follow: false, span, end: drag.current.end - (by / Math.max(1, box.current.clientWidth - LEFT)) * span });
  };
  const up = (event) => {
    const clicked = drag.current && !drag.current.moved;
    drag.current = null;
    if (!clicked) return;
    const named = name(event);
    if (named === null) go?.(timeAt(event));
    else if (named) choose(named);
  };
  const keys = (event) => {
    const by = { ArrowLeft: -0.2, ArrowRight: 0.2 }[event.key];
    if (by && !go) { event.preventDefault(); event.stopPropagation(); setView({ follow: false, span, end: end + by * span }); }
  };
  return html`<${Panel} name="Timeline" wide kind="timeline" aside=${html`<span class="commands">
      <span class="soft legend">▶ decides ■ safe ○ stopped | decision, ✕ failed, ⚠ fault, ? judgement${predicates.length > 0 && "; predicates: ▬ true, ─ false, ▨ unknown"}</span>
      <button onClick=${() => zoom(0.5)} title="+" aria-label="Zoom in">+</button><button onClick=${() => zoom(2)} title="-" aria-label="Zoom out">−</button>
      <button onClick=${() => setView({ follow: false, span: Math.max(1, last - first), end: last })} title="0">all</button>
      ${!go && html`<button aria-pressed=${view.follow} onClick=${() => setView({ ...view, follow: !view.follow, end })}>keep to now</button>`}</span>`}>
    <div class="held">${go && !history.asked && html`<p class="empty" role="status">Loading the lanes…</p>`}<canvas ref=${box} tabindex="0" role="img" aria-label=${`Timeline from ${clock(begin)} to ${clock(end)} of ${counted(lanes, "ensemble")}, ${counted(predicates, "predicate")}, ${counted(history.faults, "fault")}`}
      onPointerDown=${down} onPointerMove=${move} onPointerUp=${up} onPointerLeave=${() => show(null)} onKeyDown=${keys}></canvas>
      ${tip && html`<div class="tip number" role="tooltip" style=${`left:${tip.x}px;top:${tip.y}px`}>${tip.text}</div>`}</div>
    ${legend.length > 0 && html`<p class="legend tints">${legend.map(([own, name]) => html`<span key=${name}><i class="swatch" style=${`background:var(--${own})`}></i>${name}</span>`)}</p>`}
    <p class="told soft number">${(selected && decision(history, scene, frame, selected)) || "Nothing is decided yet."}${faultsAt(history, frame.time)}</p>
  <//>`;
}

// The changes of a predicate: where none is kept any more, for many others have changed since, its value is known from its frame.
function changesOf(scene, frame, history, name) {
  const changes = history.predicates.get(name);
  if (changes?.length) return changes;
  const place = scene.predicates.findIndex((each) => each.name === name), value = frame.predicates[place];
  return value === undefined || scene.source === "record" ? [] : [{ time: frame.changed[place] ?? frame.time, status: value === null ? "unknown" : String(value) }];
}

function step(span, room) {
  const least = span / Math.max(2, room / 90);
  for (const each of [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 21600, 86400]) if (each >= least) return each;
  return 604800;
}

// Draws; returns what is where, in words, the smaller of things that lie over each other last.
function draw(canvas, { scene, frame, history, lanes, predicates, courses, selected, begin, end, last: until }) {
  if (!canvas || !canvas.clientWidth) return [];
  const wide = canvas.clientWidth, base = HEAD + LANE * Math.max(1, lanes.length), tall = base + THIN * predicates.length + 4;
  const hits = [];
  const hit = (left, right, top, bottom, text) => { if (hits.length < 5000) hits.push({ left, right, top, bottom, text }); };
  const ratio = window.devicePixelRatio || 1;
  if (canvas.width !== Math.round(wide * ratio) || canvas.height !== Math.round(tall * ratio)) {
    canvas.width = Math.round(wide * ratio);
    canvas.height = Math.round(tall * ratio);
    canvas.style.height = `${tall}px`;
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, wide, tall);
  const names = ["ink", "soft", "line", "good", "bad", "off", "mark", "mark-soft", "bad-soft", "good-soft", "off-soft", "paper", "wait", "on-action"];
  const tint = Object.fromEntries(names.map((each) => [each, colour(each)]));
  const font = (size, weight = 400) => `${weight} ${size}px system-ui, "DejaVu Sans", sans-serif`;
  const room = wide - LEFT;
  const x = (time) => LEFT + ((time - begin) / (end - begin)) * room;
  context.font = font(11);
  context.textBaseline = "middle";
  const every = step(end - begin, room);
  let labelled = 0;
  for (let time = Math.ceil(begin / every) * every; time <= end; time += every) {
    if (time < -1e-9) continue;
    context.fillStyle = tint.line;
    context.fillRect(x(time), 0, 1, tall);
    context.fillStyle = tint.soft;
    const text = clock(time, digits(every)), width = context.measureText(text).width;
    const at = Math.min(x(time) + 3, wide - width - 2);
    if (at < labelled) continue;   // where the last one has no room
    context.fillText(text, at, 7);
    labelled = at + width + 8;
  }
  const labels = Object.fromEntries(scene.ensembles.map((each) => [each.path, called(each)]));
  // Dots, which are none of the values, where nothing is known.
  const unknown = (since, until, at, text) => {
    const left = Math.max(LEFT, x(since)), right = Math.min(wide, x(until));
    if (right - left < 2) return;
    context.fillStyle = tint.soft;
    for (let each = left; each < right; each += 8) context.fillRect(each, at, 1.5, 1.5);
    hit(left, right, at - 6, at + 6, text);
  };
  const isRecord = scene.source === "record", [since, to] = isRecord ? [history.asked?.first ?? until, history.asked?.last ?? until] : [0, frame.time];
  const on = isRecord ? Math.min(end, until) : Math.min(end, frame.time);   // What goes on is known until then.
  lanes.forEach((path, row) => {
    const top = HEAD + row * LANE;
    const lane = history.lane(path);
    if (path === selected) { context.fillStyle = tint["mark-soft"]; context.fillRect(0, top, LEFT - 4, LANE - 4); }
    context.fillStyle = tint.ink;
    context.font = font(12, 600);
    context.fillText(clip(context, labels[path] ?? path, LEFT - 14), 6, top + 16);
    for (const [kind, at, word] of [["mode", 5, "modes"], ["life", 20, "actions"], ["decision", 34, "decisions"]]) {
      const early = isRecord ? since : history.kept[kind] ?? 0;
      unknown(Math.max(begin, 0), early, top + at, isRecord ? "loading" : `the ${word} before ${clock(early)} are not kept`);
      if (isRecord) unknown(to, Math.min(end, until), top + at, "loading");
    }
    const modes = lane.modes;
    let place = Math.max(0, from(modes, begin, (each) => each.time) - 1);
    for (; place < modes.length && modes[place].time <= end; place += 1) {
      const [left, right] = [Math.max(LEFT, x(modes[place].time)), Math.min(wide, place + 1 < modes.length ? x(modes[place + 1].time) : x(on))];
      if (right <= left) continue;
      const name = modes[place].name;
      if (modes[place].count > 1) {
        hit(left, right, top, top + 10, `${path}: ${modes[place].count} changes of its mode from ${clock(modes[place].time)} on, too close to draw: zoom in`);
        context.fillStyle = tint.off;
        context.fillRect(left, top + 2, right - left, 7);
        hatch(context, left, top + 2, right - left, 7, tint.paper);
        continue;
      }
      hit(left, right, top, top + 10, `${path} ${{ deciding: "decides", safe: "is safe", stopped: "is stopped" }[name] ?? name} from ${clock(modes[place].time)}${modes[place].detail ? `\n${modes[place].detail}` : ""}`);
      context.fillStyle = tint[TINTS[name]] ?? tint.off;
      context.fillRect(left, top + 2, right - left, 7);
      if (name === "safe") hatch(context, left, top + 2, right - left, 7, tint.paper);
      if (name === "stopped") { context.fillStyle = tint.paper; context.fillRect(left, top + 4, right - left, 3); }
      context.font = font(9, name === "stopped" ? 700 : 400);
      if (right - left > 16) { context.fillStyle = name === "stopped" ? tint.ink : tint.paper; context.fillText(SIGNS[name] ?? "", left + 3, top + 6); }
    }
    context.font = font(11);
    const named = [];   // Where which action has its name.
    const first = Math.max(0, from(lane.lives, begin, (each) => each.to ?? Infinity));
    let drawn = -1;
    for (let index = first; index < lane.lives.length && lane.lives[index].from <= end; index += 1) {
      const life = lane.lives[index], bad = ["failed", "timed_out", "abandoned"].includes(life.status);
      const left = Math.max(LEFT, x(life.from)), right = Math.min(wide, Math.max(x(life.to ?? on), left + 2));
      if (right < LEFT || (right - left < 3 && Math.floor(left) === drawn && !bad)) continue;
      drawn = Math.floor(left);
      if (life.count > 1) {
        hit(left, right, top + 11, top + 29, `${life.count} actions from ${clock(life.from)} to ${clock(life.to ?? on)}, too close to draw: zoom in\nthe last ${bad ? "that failed" : "one"}: ${life.action}, ${life.status.replace("_", " ")}`);
        context.fillStyle = bad ? tint.bad : tint.soft;
        context.fillRect(left, top + 12, right - left, 16);
        hatch(context, left, top + 12, right - left, 16, tint.paper);
        continue;
      }
      hit(left, right, top + 11, top + 29, `${life.action}: ${clock(life.from)} ${life.to == null ? `on, ${seconds(frame.time - life.from)} so far` : `to ${clock(life.to)}, ${seconds(life.to - life.from)}, ${life.status.replace("_", " ")}`}${life.detail ? `\n${life.detail}` : ""}`);
      const own = tinted(scene, path, life.action);
      context.fillStyle = colour(own);
      context.strokeStyle = bad ? tint.bad : life.to == null ? tint.ink : edge(own);
      context.lineWidth = 1;
      context.fillRect(left, top + 12, right - left, 16);
      context.strokeRect(left + 0.5, top + 12.5, Math.max(1, right - left - 1), 15);
      if (bad) { context.fillStyle = tint.bad; context.fillRect(left, top + 25, right - left, 3); }
      const name = clip(context, `${bad ? "✕ " : ""}${life.action}`, right - left - 8);
      if (name) {
        context.fillStyle = tint["on-action"];
        context.fillText(name, left + 4, top + 20.5);
        named.push({ left, right, action: life.action });
      } else if (bad) {
        context.fillStyle = tint["on-action"];
        if (right - left > 10) context.fillText("✕", (left + right) / 2 - 4, top + 19.5);
      }
    }
    for (const each of lane.judged) {
      const left = Math.max(LEFT, x(each.from)), right = Math.min(wide, Math.max(x(each.to ?? frame.time), left + 6));
      if (each.from > end || right <= LEFT || (each.to ?? frame.time) < begin) continue;
      hit(left, right, top, top + 12, `? ${path} ${each.name} from ${clock(each.from)}${each.to == null ? "" : ` to ${clock(each.to)}`}\n${each.text}`);
      context.fillStyle = tint.wait;
      for (let at = left; at < right; at += 6) context.fillRect(at, top + 9.5, Math.min(4, right - at), 2.5);
      if (each.from < begin) continue;
      context.fillRect(left, top - 1, 12, 12);
      context.fillStyle = tint.paper;
      context.font = font(11, 700);
      context.fillText("?", left + 3.2, top + 5.5);
      context.font = font(11);
    }
    const decisions = lane.decisions;
    let shown = -99;
    for (let index = from(decisions, begin, (each) => each.time); index < decisions.length && decisions[index].time <= end;) {
      const first = index, left = x(decisions[first].time);
      let right = left, before = -9, count = 0;
      const own = tinted(scene, path, decisions[first].name);
      context.fillStyle = edge(own);
      for (; index < decisions.length && decisions[index].time <= end && decisions[index].name === decisions[first].name && decisions[index].status === decisions[first].status; index += 1) {
        const at = x(decisions[index].time);
        if (at - right > NEAR) break;
        right = at;
        count += decisions[index].count ?? 1;
        if (at - before < 3) continue;   // so that a dense run is a bar with strokes, and not a block of another meaning
        before = at;
        context.fillRect(at, top + 30, 1.5, 8);
      }
      const several = index - first > 1, mixed = decisions[first].status === "several";   // of which the last alone is known here
      if (several) {
        context.fillStyle = mixed ? tint.soft : colour(own);
        context.fillRect(left, top + 32, right - left, 4);
        if (mixed) hatch(context, left, top + 32, right - left, 4, tint.paper);
        hit(left, right, top + 29, top + 42, `${mixed ? "several actions" : decisions[first].name} decided ${count.toLocaleString("en")} times, ${clock(decisions[first].time)} to ${clock(decisions[index - 1].time)}`);
      }
      if (!several || (right - left) / (index - first) > 6) {
        for (let place = first; place < index; place += 1) {
          const at = x(decisions[place].time);
          hit(at, at + 1.5, top + 29, top + 42, `${clock(decisions[place].time)} ${mixed ? `the last of ${decisions[place].count} decisions: ` : ""}${told(decisions[place])}`);
        }
      }
      const next = index < decisions.length ? Math.min(wide, x(decisions[index].time)) : wide;
      const isNamed = named.some((each) => each.action === decisions[first].name && each.left <= right + 2 && left <= each.right);
      if (isNamed || mixed) continue;   // by the bar above
      if (left - shown > 70 && next - right > 34) {
        context.fillStyle = tint.soft;
        context.fillText(clip(context, `${decisions[first].name}${count > 1 ? ` ×${count}` : ""}`, Math.min(next - right - 6, 140)), right + 4, top + 35);
        shown = left;
      } else if (several && right - left > 60) {
        const text = clip(context, ` ${decisions[first].name} ×${count} `, right - left - 8);
        const width = context.measureText(text).width;
        context.fillStyle = tint.paper;
        context.fillRect(left + 3, top + 29, width, 11);
        context.fillStyle = tint.soft;
        context.fillText(text, left + 3, top + 35);
        shown = left;
      }
    }
    context.fillStyle = tint.line;
    context.fillRect(0, top + LANE - 3, wide, 1);
  });
  predicates.forEach((name, row) => {
    const top = base + row * THIN, changes = courses[row];
    context.font = font(11);
    context.fillStyle = tint.ink;
    context.fillText(clip(context, name, LEFT - 14), 6, top + 7);
    hit(0, LEFT - 6, top, top + 14, name);
    if (isRecord) { unknown(Math.max(begin, 0), since, top + 7, "loading"); unknown(to, Math.min(end, until), top + 7, "loading"); }
    const known = changes[0]?.time ?? frame.time;
    if ((!isRecord || history.asked) && known > Math.max(begin, 0)) {   // dots, which are none of the values
      const right = Math.min(wide, x(known));
      context.fillStyle = tint.soft;
      for (let at = Math.max(LEFT, x(0)); at < right; at += 8) context.fillRect(at, top + 7, 1.5, 1.5);
      context.font = font(9);
      if (right - Math.max(LEFT, x(0)) > 110) { context.clearRect(right - 86, top + 1, 84, 13); context.fillText("not known before", right - 84, top + 7.5); }
      hit(Math.max(LEFT, x(0)), right, top, top + 14, `${name} is not known before ${clock(known)}`);
    }
    let drawn = -1;
    for (let place = Math.max(0, from(changes, begin, (each) => each.time) - 1); place < changes.length && changes[place].time <= end; place += 1) {
      let dense = place;
      while (dense + 1 < changes.length && x(changes[dense + 1].time) - x(changes[dense].time) < 2) dense += 1;
      const together = dense - place > 2 ? { time: changes[place].time, status: "several", count: dense - place } : null;
      if (together) place = dense - 1;   // closer than can be drawn
      const { time, status, count } = together ?? changes[place], to = changes[place + 1]?.time ?? Math.max(time, scene.source === "record" ? until : frame.time);
      const left = Math.max(LEFT, x(time)), right = Math.min(wide, x(to));
      if (right <= LEFT || right - drawn < 1) continue;
      drawn = right;
      const width = Math.max(1, right - left);
      if (status === "several") {
        context.fillStyle = tint.good;
        context.fillRect(left, top + 2, width, 10);
        hatch(context, left, top + 2, width, 10, tint.paper);
        hit(left, right, top, top + 14, `${name} changes ${count} times from ${clock(time)} to ${clock(to)}: zoom in`);
        continue;
      }
      context.fillStyle = status === "true" ? tint.good : status === "false" ? tint.off : tint.wait;
      if (status === "true") context.fillRect(left, top + 2, width, 10);
      else if (status === "false") context.fillRect(left, top + 7, width, 1.5);
      else { context.fillRect(left, top + 2, width, 10); hatch(context, left, top + 2, width, 10, tint.paper); }
      hit(left, right, top, top + 14, `${name} ${status} from ${clock(time)}${changes[place + 1] ? ` to ${clock(to)}` : ""}`);
    }
  });
  let last = -99;
  context.font = font(12);
  for (let index = from(history.faults, begin, (each) => each.time); index < history.faults.length && history.faults[index].time <= end; index += 1) {
    const left = x(history.faults[index].time);
    if (left - last < 9) continue;
    last = left;
    context.fillStyle = tint.bad;
    context.fillText("⚠", left - 5, HEAD - 5);
    const fault = history.faults[index], row = lanes.findIndex((path) => `${fault.source}/`.startsWith(`${path}/`));
    if (row >= 0) context.fillRect(left, HEAD + row * LANE, 1, LANE - 4);
    hit(left - 6, left + 6, 0, HEAD, blamed(fault));
  }
  if (frame.time >= begin && frame.time <= end + 1e-9) {
    context.fillStyle = tint.mark;
    context.fillRect(Math.min(wide - 2, x(frame.time)), 0, 2, tall);
  }
  return hits;
}

function clip(context, text, room) {
  if (room < 8) return "";
  if (context.measureText(text).width <= room) return text;
  let length = text.length;
  while (length > 3 && context.measureText(`${text.slice(0, length)}…`).width > room) length -= 1;
  const short = `${text.slice(0, length)}…`;
  return context.measureText(short).width > room ? "" : short;   // of which nobody would know the whole
}

function hatch(context, left, top, width, height, ink) {
  context.save();
  context.beginPath();
  context.rect(left, top, width, height);
  context.clip();
  context.strokeStyle = ink;
  context.lineWidth = 1.5;
  for (let at = left - height; at < left + width; at += 6) {
    context.beginPath();
    context.moveTo(at, top + height);
    context.lineTo(at + height, top);
    context.stroke();
  }
  context.restore();
}

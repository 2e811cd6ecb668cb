// The timeline: a lane an ensemble, with modes, lives of actions and decisions; faults above. It zooms and scrolls.
import { html, useEffect, useRef } from "./vendor/htm-preact.js";
import { called, clock, colour, SIGNS } from "./words.js";

const LANE = 46, HEAD = 24, LEFT = 118, MOST = 10;
const TINTS = { deciding: "good", safe: "bad", stopped: "off" };

// What happened, by ensemble, in the order of time; kept up to date event by event.
export class History {
  constructor() { this.clear(); }

  clear() {
    this.faults = [];
    this.lanes = new Map();
    this.first = 0;
  }

  lane(path) {
    if (!this.lanes.has(path)) this.lanes.set(path, { modes: [], lives: [], open: new Map(), decisions: [], ends: [] });
    return this.lanes.get(path);
  }

  add(event) {
    if (event.kind === "fault") {
      this.faults.push(event);
      if (this.faults.length > 2000) this.faults.shift();
      return;
    }
    const lane = this.lane(event.source);
    if (event.kind === "mode") lane.modes.push(event);
    else if (event.kind === "decision") lane.decisions.push(event);
    else if (event.kind === "life") {
      if (event.status === "running") {
        const life = { from: event.time, to: null, action: event.name, status: "running" };
        lane.lives.push(life);
        lane.open.set(event.life, life);
      } else {
        const life = lane.open.get(event.life);
        if (life) { life.to = event.time; life.status = event.status; lane.open.delete(event.life); }
        else lane.lives.push({ from: event.time, to: event.time, action: event.name, status: event.status });
      }
    }
    if (lane.lives.length > 30000) lane.lives.splice(0, 10000);
    if (lane.decisions.length > 60000) lane.decisions.splice(0, 20000);
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

export function Timeline({ scene, frame, history, selected, view, setView, go, scheme, extent }) {
  const box = useRef(null);
  const drag = useRef(null);
  const lanes = lanesOf(scene, selected);
  const [first, last] = extent;
  const span = view.span;
  const end = view.follow ? (scene.source === "record" ? Math.min(last, Math.max(span + first, frame.time + span / 2)) : frame.time) : view.end;
  const begin = end - span;
  useEffect(() => draw(box.current, { scene, frame, history, lanes, selected, begin, end }));
  const timeAt = (event) => {
    const { left, width } = box.current.getBoundingClientRect();
    return begin + (Math.max(0, event.clientX - left - LEFT) / Math.max(1, width - LEFT)) * span;
  };
  const zoom = (factor, about) => {
    const wide = Math.max(0.05, Math.min(Math.max(10, (last - first) * 1.2), span * factor));
    if (view.follow && about == null) return setView({ ...view, span: wide });
    const at = about ?? (begin + end) / 2;
    setView({ follow: false, span: wide, end: at + ((end - at) / span) * wide });
  };
  useEffect(() => {
    const canvas = box.current;
    const wheel = (event) => {
      if (!event.ctrlKey && !event.shiftKey && Math.abs(event.deltaX) < Math.abs(event.deltaY) && !canvas.matches(":focus")) return;
      event.preventDefault();
      if (event.shiftKey || Math.abs(event.deltaX) > Math.abs(event.deltaY)) setView({ follow: false, span, end: end + ((event.deltaX || event.deltaY) / canvas.clientWidth) * span });
      else zoom(event.deltaY > 0 ? 1.25 : 0.8, timeAt(event));
    };
    canvas.addEventListener("wheel", wheel, { passive: false });
    return () => canvas.removeEventListener("wheel", wheel);
  });
  const down = (event) => { drag.current = { x: event.clientX, end, moved: false }; event.currentTarget.setPointerCapture(event.pointerId); };
  const move = (event) => {
    if (!drag.current) return;
    const by = event.clientX - drag.current.x;
    if (Math.abs(by) > 4) drag.current.moved = true;
    if (drag.current.moved) setView({ follow: false, span, end: drag.current.end - (by / Math.max(1, box.current.clientWidth - LEFT)) * span });
  };
  const up = (event) => {
    const clicked = drag.current && !drag.current.moved;
    drag.current = null;
    if (clicked && go) go(timeAt(event));
  };
  const keys = (event) => {
    const by = { ArrowLeft: -0.2, ArrowRight: 0.2 }[event.key];
    if (by && !go) { event.preventDefault(); event.stopPropagation(); setView({ follow: false, span, end: end + by * span }); }
  };
  return html`<section class="panel wide timeline" aria-label="Timeline">
    <div class="head"><h2>Timeline</h2><span class="commands">
      <span class="soft">▶ decides ■ safe ○ stopped | decision, ✕ failed, ⚠ fault</span>
      <button onClick=${() => zoom(0.5)} title="+" aria-label="Zoom in">+</button><button onClick=${() => zoom(2)} title="-" aria-label="Zoom out">−</button>
      <button onClick=${() => setView({ follow: false, span: Math.max(1, last - first), end: last })} title="0">all</button>
      <button aria-pressed=${view.follow} onClick=${() => setView({ ...view, follow: !view.follow, end })}>follow</button></span></div>
    <canvas ref=${box} tabindex="0" role="img" aria-label=${`Timeline from ${clock(begin)} to ${clock(end)} of ${lanes.length} ensembles, ${history.faults.length} faults`}
      onPointerDown=${down} onPointerMove=${move} onPointerUp=${up} onKeyDown=${keys}></canvas>
  </section>`;
}

function step(span, room) {
  const least = span / Math.max(2, room / 90);
  for (const each of [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 21600, 86400]) if (each >= least) return each;
  return 604800;
}

function draw(canvas, { scene, frame, history, lanes, selected, begin, end }) {
  if (!canvas || !canvas.clientWidth) return;
  const wide = canvas.clientWidth, tall = HEAD + LANE * Math.max(1, lanes.length) + 4;
  const ratio = window.devicePixelRatio || 1;
  if (canvas.width !== Math.round(wide * ratio) || canvas.height !== Math.round(tall * ratio)) {
    canvas.width = Math.round(wide * ratio);
    canvas.height = Math.round(tall * ratio);
    canvas.style.height = `${tall}px`;
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, wide, tall);
  const names = ["ink", "soft", "line", "good", "bad", "off", "mark", "mark-soft", "bad-soft", "good-soft", "off-soft", "paper"];
  const tint = Object.fromEntries(names.map((each) => [each, colour(each)]));
  const font = (size, weight = 400) => `${weight} ${size}px system-ui, "DejaVu Sans", sans-serif`;
  const room = wide - LEFT;
  const x = (time) => LEFT + ((time - begin) / (end - begin)) * room;
  context.font = font(11);
  context.textBaseline = "middle";
  const every = step(end - begin, room);
  for (let time = Math.ceil(begin / every) * every; time <= end; time += every) {
    if (time < -1e-9) continue;
    context.fillStyle = tint.line;
    context.fillRect(x(time), 0, 1, tall);
    context.fillStyle = tint.soft;
    context.fillText(clock(time), x(time) + 3, 7);
  }
  const labels = Object.fromEntries(scene.ensembles.map((each) => [each.path, called(each)]));
  lanes.forEach((path, row) => {
    const top = HEAD + row * LANE;
    const lane = history.lane(path);
    if (path === selected) { context.fillStyle = tint["mark-soft"]; context.fillRect(0, top, LEFT - 4, LANE - 4); }
    context.fillStyle = tint.ink;
    context.font = font(12, 600);
    context.fillText(clip(context, labels[path] ?? path, LEFT - 14), 6, top + 16);
    const modes = lane.modes;
    let place = Math.max(0, from(modes, begin, (each) => each.time) - 1);
    for (; place < modes.length && modes[place].time <= end; place += 1) {
      const [left, right] = [Math.max(LEFT, x(modes[place].time)), Math.min(wide, place + 1 < modes.length ? x(modes[place + 1].time) : x(Math.min(end, frame.time)))];
      if (right <= left) continue;
      const name = modes[place].name;
      context.fillStyle = tint[TINTS[name]] ?? tint.off;
      context.fillRect(left, top + 2, right - left, 7);
      if (name === "safe") hatch(context, left, top + 2, right - left, 7, tint.paper);
      if (name === "stopped") { context.fillStyle = tint.paper; context.fillRect(left, top + 4, right - left, 3); }
      context.font = font(9);
      if (right - left > 16) { context.fillStyle = tint.paper; context.fillText(SIGNS[name] ?? "", left + 3, top + 6); }
    }
    context.font = font(11);
    const first = Math.max(0, from(lane.lives, begin, (each) => each.to ?? Infinity));
    let drawn = -1;
    for (let index = first; index < lane.lives.length && lane.lives[index].from <= end; index += 1) {
      const life = lane.lives[index];
      const left = Math.max(LEFT, x(life.from)), right = Math.min(wide, Math.max(x(life.to ?? Math.min(end, frame.time)), left + 2));
      if (right < LEFT || (right - left < 3 && Math.floor(left) === drawn)) continue;
      drawn = Math.floor(left);
      const bad = ["failed", "timed_out", "abandoned"].includes(life.status);
      context.fillStyle = bad ? tint["bad-soft"] : life.to == null ? tint["good-soft"] : tint["off-soft"];
      context.strokeStyle = bad ? tint.bad : life.to == null ? tint.good : tint.off;
      context.lineWidth = 1;
      context.fillRect(left, top + 12, right - left, 16);
      context.strokeRect(left + 0.5, top + 12.5, Math.max(1, right - left - 1), 15);
      if (right - left > 22) {
        context.fillStyle = tint.ink;
        context.fillText(clip(context, `${bad ? "✕ " : ""}${life.action}`, right - left - 6), left + 4, top + 20.5);
      }
    }
    const decisions = lane.decisions;
    let before = -9, shown = -99;
    for (let index = from(decisions, begin, (each) => each.time); index < decisions.length && decisions[index].time <= end; index += 1) {
      const left = x(decisions[index].time);
      if (left - before < 1.5) continue;
      before = left;
      context.fillStyle = tint.mark;
      context.fillRect(left, top + 30, 1.5, 8);
      if (left - shown > 70) {
        const next = decisions[index + 1] ? x(decisions[index + 1].time) : wide;
        if (next - left > 34) { context.fillStyle = tint.soft; context.fillText(clip(context, decisions[index].name, Math.min(next - left - 6, 120)), left + 4, top + 35); shown = left; }
      }
    }
    context.fillStyle = tint.line;
    context.fillRect(0, top + LANE - 3, wide, 1);
  });
  let last = -99;
  context.font = font(12);
  for (let index = from(history.faults, begin, (each) => each.time); index < history.faults.length && history.faults[index].time <= end; index += 1) {
    const left = x(history.faults[index].time);
    if (left - last < 9) continue;
    last = left;
    context.fillStyle = tint.bad;
    context.fillText("⚠", left - 5, HEAD - 5);
    context.globalAlpha = 0.4;
    context.fillRect(left, HEAD, 1, tall);
    context.globalAlpha = 1;
  }
  if (frame.time >= begin && frame.time <= end + 1e-9) {
    context.fillStyle = tint.mark;
    context.fillRect(Math.min(wide - 2, x(frame.time)), 0, 2, tall);
  }
}

function clip(context, text, room) {
  if (room < 8) return "";
  if (context.measureText(text).width <= room) return text;
  let length = text.length;
  while (length > 1 && context.measureText(`${text.slice(0, length)}…`).width > room) length -= 1;
  return `${text.slice(0, length)}…`;
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

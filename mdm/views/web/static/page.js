// The page: what is told is kept here, and drawn once a frame.
import { html, render, useEffect, useState } from "./vendor/htm-preact.js";
import { Connection } from "./connection.js";
import { Detail, Tree } from "./ensembles.js";
import { Headline } from "./judgement.js";
import { Counts, Faults, Predicates, Team } from "./facts.js";
import { Floor } from "./floor.js";
import { Panel, settle } from "./panel.js";
import { Part } from "./part.js";
import { Plots, Seen } from "./plots.js";
import { Policy } from "./policy.js";
import { Question } from "./question.js";
import { History, Timeline, wantedLanes } from "./timeline.js";
import { Why } from "./why.js";
import { clock } from "./words.js";

const told = {
  scene: null, frame: null, cursor: 0, link: "lost", reason: "", ended: null, selected: null, frozen: false, playing: false, speed: 1,
  why: null, pictures: null, asked: null, said: null, help: false, history: new History(), seen: new Seen(), course: null,
  view: { follow: true, span: 30, end: 0 }, scheme: document.documentElement.dataset.scheme ?? "", scenes: 0,
};
let waiting = false;   // A frame is asked for and has not come.
let wanted = null;     // Of a record, the time that is wanted next.
let asking = null;     // Of a record, the time that is asked for.
let clocked = null;
let coming = null;     // A scene, until the first frame of it has come: a frame is drawn with its own scene.
let isAnew = false;    // The connection is new, and nothing has come through it.
let fuller = null;     // The picture before ensembles went, and when they went.
const link = new Connection((message) => { try { receive(message); } finally { schedule(); } }, (state, reason) => {
  told.link = state; told.reason = reason; waiting = false; coming = null; stepped = later = null; courseOf = null; lanesOf = false;
  if (state === "open") { told.cursor = 0; isAnew = true; } else { told.asked = null; told.playing = false; keep(); }
  schedule();
});

let later = null;      // A step that waits for the frame that is asked for.
let stepped = null;    // The step that is asked for, and from where.
let questions = 0;     // How often somebody has asked why.
let askedOf = -1;      // The number of the decision when why was asked.
let courseOf = null;   // Of a record, the ensemble and the time of which the course is asked for, as text.
let lanesOf = false;   // Of a record, lanes are asked for and have not come.
let drawn = "";        // The ensemble and the time that the timeline shows, as text, and since when it has been them.
let drawnSince = 0;
let asked = null;      // When the decision was made of which it is told why.
const place = () => told.scene.ensembles.findIndex((each) => each.path === told.selected);
const decided = () => told.frame?.details?.[told.selected]?.decided;
const isRecord = () => told.scene?.source === "record";
const BRIEF = 2_500;   // Milliseconds for which it is told that there is no further step.
const DONE = 6_000;    // Milliseconds for which it is told that a command is carried out; a refusal stays.
const SHUTS = 10_000;   // Milliseconds before the end of a program in which it takes its ensembles down.
const SOON = 1_000;    // Milliseconds after which it is asked again of a record of which more will be known soon.
const STILL = 200;     // Milliseconds for which the timeline stands still before the course of what it shows is asked for.
const isOpen = () => told.link === "open";
const close = () => (told.selected ? [told.selected] : []);

function receive(message) {
  if (message.scene) {
    if (told.scene && told.scene.version !== message.scene.version) { location.reload(); return; }
    if (told.frame) coming = message.scene; else enter(message.scene);
    if (!waiting) ask(isRecord() ? (told.frame?.time ?? message.scene.first) : null);
  } else if (message.frame) {
    waiting = false;
    if (isAnew) told.history.clear();
    isAnew = false;
    if (coming) enter(coming);
    coming = null;
    if (isRecord() && told.frame?.time !== message.frame.time) bringIntoSight(message.frame.time);
    told.frame = message.frame;
    if (stepped?.time === message.frame.time) stay(stepped);
    stepped = null;
    for (const event of message.events) told.history.add(event);
    const more = message.cursor > told.cursor;
    told.cursor = message.cursor;
    if (!isRecord()) told.seen.add(told.selected, message.frame, message.frame.ensembles[place()]?.epoch ?? 0);
    if (isRecord() && !told.playing && told.why && asked !== decided()) why();   // of the decision shown now
    if (isRecord() && more && wanted == null) wanted = told.frame.time;   // until all events are here
    if (told.scene.pending) setTimeout(() => { wanted ??= told.frame.time; schedule(); }, SOON);   // until all is known
    Object.assign(told.history.kept, message.kept);
  } else if (message.refused || message.done) {
    told.said = message;
    if (message.done) setTimeout(() => { if (told.said === message) { told.said = null; schedule(); } }, DONE);
  } else if (message.lanes) {
    lanesOf = false;
    told.history.show({ ...message, asked: { ...message.asked, scene: told.scene.predicates.length } });
  } else if ("course" in message) {
    courseOf = null;
    told.course = message;
  } else if (message.pictures) {
    told.pictures = message;
  } else if ("why" in message && message.ensemble === told.selected) {
    told.why = { ...message, decided: decidedAt(message), question: questions };
  }
}

function enter(scene) {
  if (told.frame && scene.began === told.scene.began && scene.ensembles.length < told.scene.ensembles.length && !isShutting()) {
    fuller = { scene: told.scene, frame: told.frame, selected: told.selected, since: performance.now() };
  }
  if (told.scene && scene.began !== told.scene.began) Object.assign(told, { said: null, why: null, asked: null });   // of the run before
  told.scene = scene;
  told.history.room = scene.room ?? {};
  told.scenes += 1;
  if (!scene.ensembles.some((each) => each.path === told.selected)) told.selected = scene.ensembles[0]?.path ?? null;
  document.title = `${scene.title || "robot"} - mdm`;
  if (told.scenes === 1 && isRecord()) told.view = { follow: false, span: Math.max(1, scene.last - scene.first), end: scene.last };
}

const isShutting = () => fuller && performance.now() - fuller.since < SHUTS;

// At the end of a program its ensembles go before the connection does: what stays is the picture with them.
function keep() {
  if (isShutting()) { const { scene, frame, selected } = fuller; Object.assign(told, { scene, frame, selected }); }
  fuller = null;
}

function ask(time) {
  if (!told.scene || waiting) { if (time != null) wanted = time; return; }
  waiting = true;
  asking = time ?? told.frame?.time ?? 0;
  if (isRecord()) link.say({ say: "at", time: asking, cursor: told.cursor, close: close() });
  else link.say({ say: "drawn", cursor: told.cursor, close: close() });
}

// Where there is no further step, that is said for a moment.
function stay({ kind, back }) {
  const text = `no ${back ? "earlier" : "further"} ${{ change: "decision for another action", mode: "change of a mode" }[kind] ?? kind}`;
  told.ended = text;
  setTimeout(() => { if (told.ended === text) { told.ended = null; schedule(); } }, BRIEF);
}

// Of a record, the view moves with the time that is shown, once that has left it.
function bringIntoSight(time) {
  const { span, end } = told.view;
  if (time < end - span - 1e-9 || time > end + 1e-9) told.view = { follow: false, span, end: Math.min(told.scene.last, Math.max(told.scene.first + span, time + span / 2)) };
}

// The time of a record that the timeline shows.
function lookedAt() {
  const { first, last } = told.scene, { span, end } = told.view;
  const from = Math.max(first, Math.min(last, end - span)), until = Math.max(from, Math.min(last, end));
  return [from, until];
}

// The course of the chosen ensemble over the time that is looked at is asked for once that stands still; lanes are at once.
function follow() {
  const wanted = lanesOf ? null : wantedLanes(told.scene, told.history, told.selected, lookedAt(), innerWidth);
  if (wanted) { lanesOf = true; link.say({ say: "lanes", ...wanted }); }
  const [first, last] = lookedAt(), shown = JSON.stringify([told.selected, first, last]), now = performance.now();
  if (shown !== drawn) { drawn = shown; drawnSince = now; }
  const { ensemble, first: from, last: until } = told.course ?? {};
  if (courseOf || !told.selected || shown === JSON.stringify([ensemble, from, until])) return;
  if (now - drawnSince < STILL) { setTimeout(schedule, STILL); return; }
  courseOf = shown;
  link.say({ say: "course", ensemble: told.selected, first, last });
}

function step(kind, back) {
  if (!isRecord() || !isOpen()) return;
  told.playing = false;
  if (waiting) { later = { kind, back }; return; }
  wanted = null;   // else the time of before were asked for behind the step
  told.ended = null;
  waiting = true;
  asking = null;
  stepped = { kind, back, time: told.frame.time };
  link.say({ say: "step", kind, time: told.frame.time, back, cursor: told.cursor, close: close() });
}

let due = false;
function schedule() {
  if (due) return;
  due = true;
  requestAnimationFrame(() => {
    due = false;
    redraw();
    afterwards();
  });
}

// What follows a drawing: the next frame is asked for, which is the acknowledgement of this one.
function afterwards() {
  if (!told.scene || told.link !== "open") return;
  if (!isRecord()) { if (!waiting && !told.frozen) ask(null); return; }
  follow();
  if (later && !waiting) { const { kind, back } = later; later = null; step(kind, back); return; }
  const now = performance.now();
  if (told.playing && told.frame) {
    const by = clocked == null ? 0 : ((now - clocked) / 1000) * told.speed;
    clocked = now;
    if (told.frame.time >= told.scene.last) told.playing = false;
    else if (!waiting) { wanted = null; ask(Math.min(told.scene.last, told.frame.time + by)); return; }
    schedule();
  } else {
    clocked = null;
    if (wanted != null && !waiting) { const time = wanted; wanted = null; ask(time); }
  }
}

function go(time) {
  told.playing = false;
  wanted = Math.max(told.scene.first, Math.min(told.scene.last, time));
  schedule();
}

function choose(path) {
  told.selected = path;
  told.why = null;
  if (isRecord() && told.frame) wanted = told.frame.time;
  schedule();
}

function why() {
  if (!isOpen()) return;
  asked = decided();
  askedOf = told.frame?.ensembles[place()]?.epoch;
  if (told.selected) link.say({ say: "why", ensemble: told.selected, time: isRecord() ? told.frame.time : null });
}

// When the decision was made of which it is told why: of a running system perhaps a later one than that asked of.
function decidedAt({ ensemble, why }) {
  const epoch = why?.epoch ?? -1;
  if (isRecord() || epoch < 0 || epoch === askedOf) return asked;
  return told.history.lane(ensemble).decisions.findLast((each) => each.life === epoch)?.time;
}

function ponder() {
  questions += 1;
  why();
}

const MOVES = {
  start: "begins to decide, and the robot may move",
  stop: "ends its action and decides nothing more",
  reset: "begins a new episode, and the robot may move",
  release: "leaves its safe mode: you answer for its causes, and the robot may move",
};

// An ensemble of a team is started, stopped and reset at all agents; it is released at one.
const everywhere = (word, ensemble) => {
  const of = `ensemble ${ensemble.slice(ensemble.indexOf("/") + 1)}`;
  const shared = Object.keys(told.frame?.team ?? {}).some((key) => key === of || key.startsWith(`${of} (`));
  return shared && word !== "release" ? " So do all agents of its team." : "";
};
const command = (word, ensemble) => { told.asked = { message: { say: "command", command: word, ensemble }, text: `${word} ${ensemble}? It ${MOVES[word]}.${everywhere(word, ensemble)}`, yes: `Yes, ${word}` }; schedule(); };
const sense = (predicate, value) => { told.asked = { message: { say: "sense", predicate, value }, text: `Set ${predicate} to ${value}? What decides on it may move the robot.`, yes: "Yes, set it" }; schedule(); };

function answer(yes) {
  if (yes) link.say(told.asked.message);
  told.asked = null;
  schedule();
}

function paint() {
  const dark = matchMedia("(prefers-color-scheme: dark)").matches;
  const shown = document.documentElement.dataset.scheme ?? (dark ? "dark" : "light");
  const other = shown === "dark" ? "light" : "dark";
  document.documentElement.dataset.scheme = other;
  localStorage.setItem("scheme", other);
  told.scheme = other;
  schedule();
}

function freeze() {
  if (!isOpen()) return;
  if (isRecord()) { told.playing = !told.playing && told.frame.time < told.scene.last; clocked = null; }
  else told.frozen = !told.frozen;
  schedule();
}

function neighbour(by) {
  const ensembles = told.scene.ensembles;
  if (ensembles.length) choose(ensembles[Math.max(0, Math.min(ensembles.length - 1, place() + by))].path);
}

// A key's words, what it does, and where: at a "record", of a "live" run, or at both.
const KEYS = {
  d: ["to the next decision", (back) => step("decision", back), "record"],
  n: ["to the next decision for another action, past those that are the same", (back) => step("change", back), "record"],
  f: ["to the next fault", (back) => step("fault", back), "record"],
  m: ["to the next change of a mode", (back) => step("mode", back), "record"],
  j: ["to where the next judgement begins", (back) => step("judgement", back), "record"],
  ArrowLeft: ["a second back", () => go(heading() - 1), "record"],
  ArrowRight: ["a second on", () => go(heading() + 1), "record"],
  " ": [{ record: "play or pause", live: "freeze the picture, or go on" }, freeze],
  ArrowUp: ["choose the ensemble above", () => neighbour(-1)],
  ArrowDown: ["choose the ensemble below", () => neighbour(1)],
  "+": ["zoom in", () => zoom(0.5)],
  "-": ["zoom out", () => zoom(2)],
  0: ["all of the time", () => { told.view = { follow: false, span: Math.max(1, extent()[1] - extent()[0]), end: extent()[1] }; schedule(); }],
  w: ["why this action", ponder],
  l: ["light or dark", paint],
  "?": ["these keys", () => { told.help = !told.help; schedule(); }],
};
const heading = () => wanted ?? (waiting && asking != null ? asking : told.frame.time);   // arrows that come fast add up
const works = ([, , where]) => !where || where === told.scene?.source;

function zoom(factor) {
  const { span, end } = told.view, wide = Math.max(0.05, span * factor), shown = told.frame.time;
  const at = isRecord() && end - span <= shown && shown <= end ? shown : end - span / 2;
  told.view = { ...told.view, span: wide, end: at + ((end - at) / span) * wide };
  schedule();
}

const extent = () => (isRecord() ? [told.scene.first, told.scene.last] : [0, told.frame?.time ?? 1]);

// Where one writes, all keys are text. A list of choices keeps those by which it chooses, which are no letters.
const takes = ({ target, key }) => (target.tagName === "SELECT" ? !/^[a-z+?-]$/i.test(key) : target.matches("input:not([type=range]), textarea"));
// What can be scrolled up or down, or chooses by these keys itself.
const scrolls = (box) => box && (box.role === "listbox" || box.scrollHeight > box.clientHeight);

addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || takes(event)) return;
  if (told.asked) return;   // The question hears the keys.
  if (event.key === "Escape" && told.help) { told.help = false; schedule(); return; }
  if (event.key === " " && event.target.tagName === "BUTTON") return;
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  const found = KEYS[key] ?? KEYS[event.key];
  if (!found || !told.frame || !works(found)) return;
  if (/^Arrow(Up|Down)$/.test(key) && scrolls(event.target.closest(".scrolls, .list"))) return;   // which scroll, or choose, themselves
  event.preventDefault();
  found[1](event.shiftKey && event.key !== "?");
});
addEventListener("resize", schedule);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { told.scheme += "'"; schedule(); });

function Header() {
  const { scene, frame } = told;
  const lost = !isOpen();
  const state = told.link === "refused" ? ["lost", `✕ refused: ${told.reason}`] : lost ? ["lost", "✕ not connected"]
    : isRecord() ? ["record", told.playing ? "▶ record, playing" : "❚❚ record"] : told.frozen ? ["frozen", "❚❚ frozen"] : ["live", "● live"];
  return html`<header>
    <h1>${scene?.title || "mdm"}</h1>
    <span class=${`badge ${state[0]}`} role="status">${state[1]}</span>
    <span class="number">${frame ? clock(frame.time) : ""}${isRecord() && frame ? ` of ${clock(scene.last)}` : ""}</span>
    ${scene?.began > 0 && frame && html`<span class="soft number">${new Date(scene.began / 1e6 + 1000 * frame.time).toLocaleString("sv")}</span>`}
    <span class="right">${!isRecord() && html`<button aria-pressed=${told.frozen} disabled=${lost} onClick=${freeze}>${told.frozen ? "go on" : "freeze"}</button>`}
      <button onClick=${paint}>light or dark</button><button aria-expanded=${told.help} onClick=${() => { told.help = !told.help; schedule(); }}>keys</button></span>
  </header>`;
}

function Help() {
  const keys = Object.entries(KEYS).filter(([, each]) => works(each));
  keys.sort(([one], [two]) => (one === "0") - (two === "0"));   // a number comes first in any object
  return html`<${Panel} name="Keys" wide><dl class="keys">
    ${keys.map(([key, [text]]) => html`<dt key=${key}><kbd>${{ " ": "space", ArrowLeft: "←", ArrowRight: "→", ArrowUp: "↑", ArrowDown: "↓" }[key] ?? key}</kbd></dt><dd>${text[told.scene?.source] ?? text}</dd>`)}</dl>
    ${isRecord() && html`<p class="soft">With shift, <kbd>d</kbd>, <kbd>n</kbd>, <kbd>f</kbd>, <kbd>m</kbd> and <kbd>j</kbd> go to the one before.</p>`}<//>`;
}

function Controls() {
  if (!isRecord() || !told.frame) return null;
  const { scene, frame } = told;
  const lost = !isOpen();
  return html`<div class="controls" role="toolbar" aria-label="Time of the record">
    <button disabled=${lost} onClick=${freeze} aria-label=${told.playing ? "Pause" : "Play"}>${told.playing ? "❚❚" : "▶"}</button>
    <select aria-label="Speed" value=${told.speed} onChange=${(event) => { told.speed = Number(event.currentTarget.value); schedule(); }}>${[0.1, 0.5, 1, 2, 5, 10, 60].map((each) => html`<option value=${each} selected=${each === told.speed}>${each}×</option>`)}</select>
    <input type="range" aria-label="Time" disabled=${lost} min=${scene.first} max=${scene.last} step="0.001" value=${frame.time} aria-valuetext=${clock(frame.time)} onInput=${(event) => go(Number(event.currentTarget.value))} />
    <span class="number">${clock(frame.time)}</span>
    <span class="steps">${[["decision", "d"], ["change", "n", "other action"], ["fault", "f"], ["mode", "m"], ["judgement", "j"]].map(([kind, key, word = kind]) => html`<span class="pair" key=${kind}><button disabled=${lost} aria-label=${`${word} before`} title=${`shift ${key}`} onClick=${() => step(kind, true)}>◀</button><button disabled=${lost} title=${key} onClick=${() => step(kind, false)}>${word} ▶</button></span>`)}</span>
    <span class="ended" role="status">${told.ended}</span>
  </div>`;
}

// The course of the chosen ensemble: of a record that of all the time that is looked at, else as far as it was seen.
function courseShown() {
  if (!isRecord()) return { course: told.seen.path === told.selected ? told.seen.course() : null, version: told.seen.times[told.seen.times.length - 1] };
  const { ensemble, course, first, last } = told.course ?? {};
  return ensemble === told.selected ? { course, version: `${first} ${last}`, range: [first, last] } : { course: null };
}

function Page() {
  const { scene, frame } = told;
  if (!scene || !frame) {
    return html`<${Header} /><main><section class="panel wide"><p class="empty">${told.link === "open" ? "Waiting for the first frame." : "Not connected. Open the address that the program has printed; this page goes on trying."}</p></section></main>`;
  }
  const at = isRecord() ? go : null;
  return html`<a class="skip" href="#main">To the ensembles</a><div class="shell"><${Header} />
    <div class="content"><${Part} name="the headline"><${Headline} scene=${scene} frame=${frame} lost=${isOpen() ? null : told.link} /><//>
    <div class="notes">${told.said && html`<p class=${`said ${told.said.refused ? "refused" : ""}`} role="status">${told.said.refused ? `✕ refused: ${told.said.refused}` : `✓ done: ${told.said.done}`}</p>`}
      ${(scene.remarks ?? []).map((text) => html`<p class="said" key=${text}>Note: ${text}</p>`)}</div>
    <main id="main" class=${isOpen() ? "" : "past"}><div class="panels">
      ${told.help && html`<${Help} />`}
      <${Part} name="the timeline"><${Timeline} scene=${scene} frame=${frame} history=${told.history} selected=${told.selected} view=${told.view} extent=${extent()}
        setView=${(view) => { told.view = view; schedule(); }} choose=${choose} go=${at} scheme=${told.scheme} /><//>
      <${Part} name="the tree of ensembles"><${Tree} scene=${scene} frame=${frame} selected=${told.selected} choose=${choose} /><//>
      <${Part} name="the ensemble"><${Detail} scene=${scene} frame=${frame} path=${told.selected} ask=${ponder} lost=${!isOpen()} control=${scene.control} command=${command} /><//>
      ${told.why && html`<${Part} name="why"><${Why} scene=${scene} why=${told.why} decides=${{ epoch: frame.ensembles[place()]?.epoch, time: decided() }} /><//>`}
      ${told.selected && html`<${Part} name="the policy"><${Policy} scene=${scene} frame=${frame} path=${told.selected} told=${told.pictures} say=${(message) => link.say(message)} lost=${!isOpen()} /><//>`}
      ${scene.floors?.length > 0 && html`<${Part} name="the floor"><${Floor} floors=${scene.floors} frame=${frame} scheme=${told.scheme} /><//>`}
      <${Part} name="the course of the belief"><${Plots} ...${courseShown()} predicates=${told.history.predicates} path=${told.selected} time=${frame.time} go=${at} scheme=${told.scheme} /><//>
      <${Part} name="the team"><${Team} team=${frame.team} /><//>
      <${Part} name="the predicates"><${Predicates} scene=${scene} frame=${frame} path=${told.selected} lost=${!isOpen()} control=${scene.control} sense=${sense} /><//>
      <${Part} name="the faults"><${Faults} faults=${told.history.faults} frame=${frame} go=${at} /><//>
      <${Part} name="latency and counts"><${Counts} statistics=${frame.statistics} path=${told.selected} /><//>
    </div></main></div><${Controls} /></div>
    ${told.asked && html`<${Part} name="the question"><${Question} key=${told.asked.text} text=${told.asked.text} yes=${told.asked.yes} answer=${answer} /><//>`}`;
}

const root = document.getElementById("page");
function redraw() {
  render(html`<${Part} name="the page"><${Page} /><//>`, root);
  settle();
}
globalThis.mdmPage = told;   // for tests and for the curious
schedule();

// What is judged of a run, in words: on top the worst, with its evidence and what to check; and beside each ensemble.
import { html } from "./vendor/htm-preact.js";
import { called, clock, seconds, SIGNS, standing } from "./words.js";

const MOST = 4;
const LONG = 10;   // Seconds from which on it is told for how long an action has lived.
const MARKS = { wrong: "✕", look: "?" };

export const judgedOf = (frame, path) => (frame.judgements ?? []).filter((each) => each.of === path && each.until == null);

// The first line is the worst judgement; it is green only where none lasts. Below it stand the others, and who waits.
export function Headline({ scene, frame, lost }) {
  if (lost) {
    return html`<section class="headline cut" aria-label="What matters most" aria-live="polite"><div class="line">
      <strong class="lost">✕ not connected</strong><span>${lost === "refused" ? "The program does not answer this page, for the reason above; it goes on trying." : "The program has ended, or runs with another address."} Below is what it told last, at ${clock(frame.time)}; it may be otherwise now.</span></div></section>`;
  }
  const told = frame.ensembles.map((each, place) => ({ each, path: scene.ensembles[place]?.path ?? "", how: standing(each, frame.time) }));
  const all = frame.judgements ?? [];
  const shown = frame.headline ? all.filter((each) => each.until == null || all[0].until != null) : [];
  const groups = alike(shown, (each) => [each.severity, each.rule, each.text.replace(/\d+/g, "#")].join(), (each) => each.of), over = all.length - shown.length;
  const worst = shown[0]?.severity;
  const judgedOnes = new Set(shown.map((each) => each.of));   // of which is said already what keeps them
  const waits = told.filter((one) => (one.how === "waiting" || one.how === "idle") && !judgedOnes.has(one.path));
  const waiting = alike(waits, ({ each, path, how }) => `${how} ${(each.waiting ?? []).join().replaceAll(path, "")}`, ({ path }) => path);
  const decide = told.filter((one) => one.how === "deciding");
  const rests = told.length > 0 && told.every(({ how }) => how === "stopped");
  const kind = worst === "wrong" ? "alarm" : worst || waits.length ? "waits" : rests || !told.length ? "rests" : "calm";
  return html`<section class=${`headline ${kind}`} aria-label="What matters most" aria-live="polite">
    ${!told.length && html`<div class="line">No ensemble has started yet.</div>`}
    <${Judgements} judgements=${groups.slice(0, MOST)} first=${frame.headline} />
    ${groups.length > MOST && html`<div class="line">and ${groups.length - MOST} more, beside their ensembles in the tree below</div>`}
    ${waiting.slice(0, MOST).map(({ each, path, how, others }) => html`<div class="line" key=${path}>
      <strong class=${how}>${SIGNS[how]} ${path} ${how === "idle" ? "has nothing to do" : "waits"}</strong>
      ${how === "idle" && html`<span class="number">since ${seconds(frame.time - each.idle)}</span>`}
      ${how === "waiting" && html`<span>for ${each.waiting.slice(0, 4).join(", ")}${each.waiting.length > 4 ? ` and ${each.waiting.length - 4} more` : ""}</span>`}
      <${Others} names=${others} /></div>`)}
    ${waiting.length > MOST && html`<div class="line">and ${waiting.length - MOST} more, in the tree below</div>`}
    ${!shown.length && !waits.length && told.length > 0 && html`<div class="line"><strong class=${rests ? "stopped" : "deciding"}>${rests ? SIGNS.stopped : SIGNS.deciding} ${
      decide.length === told.length ? (told.length === 1 ? `${told[0].path} decides` : `all ${told.length} ensembles decide`)
        : decide.length ? `${decide.length} of ${told.length} ensembles decide` : told.length === 1 ? `${told[0].path} is stopped` : "every ensemble is stopped"}</strong>
      <span>${rests ? "" : doing(scene, frame)}</span>${over > 0 && html`<span class="soft" title=${all.map(line).join("\n")}>earlier: ${line(all[0])}${over > 1 ? ` and ${over - 1} more` : ""}</span>`}</div>`}
  </section>`;
}

// What is the same of several ensembles is one, with the others by name.
function alike(all, key, name) {
  const found = new Map();
  for (const each of all) {
    const of = key(each);
    if (found.has(of)) found.get(of).others.push(name(each)); else found.set(of, { ...each, others: [] });
  }
  return [...found.values()];
}

const Others = ({ names }) => names?.length > 0 && html`<b title=${names.join(", ")}>the same of ${names.slice(0, 2).join(", ")}${names.length > 2 ? ` and ${(names.length - 2).toLocaleString("en")} more` : ""}</b>`;

const line = (each) => `${each.of}: ${each.text}, since ${clock(each.since)}${each.until == null ? "" : ` until ${clock(each.until)}`}`;

export const Judgements = ({ judgements, first }) => judgements.map((each, place) => html`<div class=${`line judged ${each.severity}`} key=${[each.rule, each.of, each.subject].join()}>
  <strong class=${each.severity === "wrong" ? "safe" : "waiting"}>${MARKS[each.severity]} ${place === 0 && first ? first : line(each)}</strong>
  <${Others} names=${each.others} />
  ${each.evidence && html`<span>${each.evidence}</span>`}<span class="remedy">${each.remedy}</span></div>`);

// The mark of an ensemble of which something is judged.
export function Mark({ frame, path }) {
  const found = judgedOf(frame, path);
  return found.length > 0 && html`<span class=${found[0].severity === "wrong" ? "safe" : "waiting"} title=${found.map(line).join("; ")}>${MARKS[found[0].severity]} ${found[0].rule}</span>`;
}

function doing(scene, frame) {
  const acting = frame.ensembles.map((each, place) => [scene.ensembles[place], each]).filter(([of, each]) => of && each.live?.length);
  if (!acting.length) return frame.ensembles.length === 1 ? frame.ensembles[0].action : "";
  const sign = ([above], [of]) => of.path.startsWith(`${above.path}/`) ? " › " : "; ";
  return acting.slice(0, 3).map(([of, each], place, all) => `${place ? sign(all[place - 1], all[place]) : ""}${called(of)}: ${each.live.map((life) => life.action + (frame.time - life.since < LONG ? "" : ` for ${seconds(frame.time - life.since)}`)).join(", ")}`).join("");
}

// Why an action was decided, as a picture: what was compared, what was observed, and what would have decided otherwise.
import { html, useEffect, useRef } from "./vendor/htm-preact.js";
import { Share } from "./bars.js";
import { Panel } from "./panel.js";
import { clock, number, percent, stateTint, tint } from "./words.js";

const ACTIONS = 12;
const NEAR = 0.15;   // The share of the largest value up to which values lie so near to each other that the axis leaves out 0.
const COMPARED = { value: "values of the actions", bound: "values of the actions, at least", vote: "votes", chance: "chances" };

// Args: why: what is told; decides: of the ensemble now, the number and the time of its last decision.
export function Why({ scene, why, decides }) {
  const { why: told, decided, question, ensemble } = why;
  const box = useRef(null);
  useEffect(() => box.current?.scrollIntoView({ block: "nearest" }), [question]);
  const isEarlier = scene.source === "live" && told?.epoch >= 0 ? told.epoch !== decides.epoch : decided !== decides.time;
  const title = `Why${told?.epoch >= 0 ? ` decision ${told.epoch}` : ""}${decided == null ? "" : ` at ${clock(decided)}`}`;
  const facts = told?.facts, own = (action) => `background:var(--${tint(scene, ensemble, action)})`;
  return html`<${Panel} name="Why" label=${title} aside=${isEarlier && html`<span class="soft">since then it has decided again</span>`}><div class="why" ref=${box}>
    ${!told ? html`<p class="empty">There is no ensemble ${ensemble} any more.</p>` : !facts ? html`<p class="empty">${told.text}</p>` : html`
    <p><i class="swatch" style=${own(facts.action_name)}></i><b>${facts.action_name}</b>${facts.state != null && html` <span class="soft">in</span> ${facts.state}`}</p>
    <${Values} facts=${facts} own=${own} />
    <${Heard} told=${told} />
    ${facts.otherwise?.length > 0 && html`<div><h3>the smallest change that decides otherwise${facts.ways > facts.otherwise.length ? `, ${facts.ways} such` : ""}</h3>
      ${facts.otherwise.map((each) => html`<${Change} change=${each} own=${own} />`)}</div>`}
    ${facts.next_states?.length > 0 && html`<div><h3>it expects next</h3>
      ${facts.next_states.map((each) => html`<${Share} key=${each.name} name=${each.name} share=${each.probability} />`)}
      ${facts.next_observations?.length > 0 && html`<p class="soft">and to observe ${facts.next_observations.map((each) => `${each.name} (${percent(each.probability)})`).join(", ")}</p>`}</div>`}
    <ul class="sentences">${(told.sentences ?? []).map((text) => html`<li key=${text}>${text}</li>`)}</ul>`}</div><//>`;
}

// All bars have one axis. It begins at 0, or at the second best value where all lie near to each other and far from 0.
function Values({ facts, own }) {
  const weighed = (facts.values ?? []).filter(({ value }) => value != null), shown = weighed.slice(0, ACTIONS);
  if (weighed.length < 2) return null;
  const all = weighed.map(({ value }) => value), second = weighed.find(({ name }) => name === facts.second)?.value ?? all[1];
  const most = Math.max(...all), least = Math.min(...all);
  const isNear = most - least < NEAR * Math.max(Math.abs(most), Math.abs(least));
  const base = isNear ? second : 0, low = Math.min(base, least), span = Math.max(base, most) - low || 1;
  const at = (value) => (100 * (value - low)) / span;
  const part = (one, other) => `left:${Math.min(at(one), at(other))}%;width:${Math.abs(at(one) - at(other))}%`;
  return html`<div><h3>${COMPARED[facts.by ?? "value"]}</h3>
    ${shown.map(({ name, value, upper }) => {
      const isChosen = name === facts.action_name, gap = isChosen && facts.margin > 0;
      const side = gap && Math.abs(value - base) > Math.abs(second - base) ? second : value;
      return html`<div class="bar ${isChosen ? "chosen" : ""}" key=${name}><span class="label" title=${name}>${name}</span>
        <span class="track axis" aria-hidden="true"><span class="fill" style=${`${part(base, side)};${own(name)}`}></span>
          ${gap && html`<span class="gap" style=${part(value, second)}></span>`}<span class="zero" style=${`left:${at(base)}%`}></span></span>
        <span class="value number">${number(value)}${upper == null ? "" : `–${number(upper)}`}</span></div>`;
    })}
    <p class="legend soft number">bars from ${isNear ? `${facts.second}, ${number(second)}` : "0"}${facts.margin > 0 && html`; <span class="gap key"></span> ahead of ${facts.second} by <b>${number(facts.margin)}</b>`}${weighed.length > shown.length && `; ${weighed.length - shown.length} more actions are worth less`}</p></div>`;
}

// The belief before the last observations and after each, a bar that comes to 1.
function Heard({ told }) {
  const beliefs = told.beliefs ?? [];
  if (beliefs.length < 2) return null;
  const influences = told.facts.influences ?? [], strongest = told.facts.moved_by;
  const row = (label, belief, mark) => html`<span class="label" title=${label}>${label}</span><span class="stack" role="img" aria-label=${told.states.map((state, place) => `${state} ${percent(belief[place])}`).join(", ")}>
    ${belief.map((chance, place) => html`<span key=${place} style=${`width:${100 * chance}%;background:var(--${stateTint(place)})`} title=${`${told.states[place]} ${percent(chance)}`}>${chance > 0.17 ? percent(chance) : ""}</span>`)}</span><span>${mark}</span>`;
  return html`<div><h3>belief before and after each observation</h3>
    <p class="tints legend">${told.states.map((state, place) => html`<span key=${state}><i class="swatch" style=${`background:var(--${stateTint(place)})`}></i>${state}</span>`)}</p>
    <div class="stacks">${row("before", beliefs[0], "")}
      ${told.heard.map(([action, name], place) => row(`${action} → ${name || "nothing"}`, beliefs[place + 1], strongest && influences[place]?.epoch === strongest.epoch ? html`<abbr title="It moved the decision most.">★</abbr>` : ""))}</div></div>`;
}

function Change({ change, own }) {
  const pairs = (change.factors ?? change.observations ?? []).map((each) => [each.factor ?? (each.of || `before decision ${each.epoch}`), each.before, each.after]);
  const then = html`<span class="then">⟶ <i class="swatch" style=${own(change.action)}></i><b>${change.action}</b></span>`;
  if (!change.moves) return html`<div class="change">${pairs.map(([of, before, after]) => html`<span class="chip" key=${of}>${[before, after].every((each) => each.endsWith(of)) ? "" : `${of} `}${before} <b>→ ${after}</b></span>`)}${then}</div>`;
  return html`<div class="change moves">${change.moves.slice(0, 4).map(({ state, before, after }) => html`<${Share} key=${state} name=${state} share=${before} after=${after} />`)}
    <p>${change.mass < 1e-7 ? "next to none" : `${percent(change.mass)} of the probability elsewhere`} ${then}</p></div>`;
}

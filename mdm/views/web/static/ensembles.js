// The tree of ensembles, and one of them at close range.
import { html, useState } from "./vendor/htm-preact.js";
import { Bar, Histogram } from "./bars.js";
import { Judgements, Mark, judgedOf } from "./judgement.js";
import { VirtualList } from "./list.js";
import { Panel } from "./panel.js";
import { called, clock, feeding, number, percent, seconds, SIGNS, since, standing, sureness } from "./words.js";

function depths(ensembles) {
  const found = [];
  for (const each of ensembles) found.push(each.parent < 0 ? 0 : (found[each.parent] ?? 0) + 1);
  return found;
}

export function Tree({ scene, frame, selected, choose }) {
  const [sought, seek] = useState("");
  const depth = depths(scene.ensembles);
  const places = scene.ensembles.map((_, place) => place)
    .filter((place) => !sought || scene.ensembles[place].path.toLowerCase().includes(sought.toLowerCase()));
  const row = (index, style) => {
    const place = places[index];
    const of = scene.ensembles[place];
    const each = frame.ensembles[place];
    if (!each) return null;
    const how = standing(each, frame.time);
    const live = each.live ?? [];
    return html`<div class="row click" role="option" id=${`listbox-${index}`} key=${of.path} style=${style} title=${`${of.path}: ${of.summary}`}
        aria-selected=${of.path === selected} onClick=${() => choose(of.path)}>
      <span style=${`width:${1.1 * depth[place]}rem;flex:none`}></span>
      <span class=${`sign ${how}`} aria-hidden="true">${SIGNS[how]}</span>
      <span class="name">${called(of)}</span><span class=${how}>${how}</span><${Mark} frame=${frame} path=${of.path} />
      ${each.wanted && html`<span class="waiting" title=${`its shield took ${each.action} in place of ${each.wanted}`}>shield</span>`}
      <span class="grow">${live.length
        ? live.map((life) => `${life.action}${life.remaining == null ? "" : `, ${number(life.remaining)} m to go`}`).join(", ")
        : each.action && how !== "stopped" ? html`<span class="soft">${each.action}</span>` : ""}</span>
      <span class="soft number">${live.length ? seconds(frame.time - live[live.length - 1].since) : ""}</span>
    </div>`;
  };
  return html`<${Panel} name="Ensembles" aside=${html`<span class="soft number">${scene.ensembles.length}</span>`}>
    <p class="soft legend">An ensemble is one process that decides: a model, its policy, and the actions that it may start.</p>
    ${scene.ensembles.length > 12 && html`<input type="search" placeholder="Find" aria-label="Find an ensemble" value=${sought} onInput=${(event) => seek(event.currentTarget.value)} />`}
    <${VirtualList} count=${places.length} height=${32} row=${row} label="Tree of ensembles" role="listbox"
      selected=${places.findIndex((place) => scene.ensembles[place].path === selected)}
      choose=${(index) => choose(scene.ensembles[places[index]].path)} />
    <p class="soft legend">${Object.entries(SIGNS).map(([word, sign]) => html`<span class=${word} key=${word}>${sign}</span> ${word}  `)}</p>
  <//>`;
}

export function Detail({ scene, frame, path, ask, lost, control, command }) {
  const place = scene.ensembles.findIndex((each) => each.path === path);
  const of = scene.ensembles[place];
  const each = frame.ensembles[place];
  if (!of || !each) return html`<${Panel} name="Ensemble"><p class="empty">None is chosen.</p><//>`;
  const detail = frame.details?.[path] ?? {};
  const how = standing(each, frame.time), begun = since(each, frame.time);
  const ended = Object.entries(frame.statistics?.ended?.[path] ?? {});
  return html`<${Panel} name="Ensemble" label=${`Ensemble ${path}`} title=${path} aside=${html`<span class=${`badge ${how}`}>${SIGNS[how]} ${how}${begun == null ? "" : ` ${seconds(frame.time - begun)}`}</span>`}>
    <${Judgements} judgements=${judgedOf(frame, path)} />
    <p class="soft said">${of.summary}${of.bound ? `; it is the action ${of.bound} of the ensemble above` : ""}</p>
    <dl>
      <dt>live</dt><dd>${each.live?.length ? each.live.map((life) => `${life.action}, for ${seconds(frame.time - life.since)}${life.remaining == null ? "" : `, ${number(life.remaining)} m to go`}`).join("; ") : html`<span class="soft">no action lasts</span>`}</dd>
      <dt>decided</dt><dd>${each.decisions || each.epoch > -1 ? html`<b>${each.action}</b>${each.wanted && html` <span class="chip waiting" title="a shield took this action in place of the policy's">shield, in place of <b>${each.wanted}</b></span>`} <span class="soft number">decision ${each.epoch}${detail.decided == null ? "" : `, ${seconds(frame.time - detail.decided)} ago`}${detail.cause ? `, ${detail.cause}` : ""}</span>` : html`<span class="soft">nothing yet</span>`}</dd>
      ${detail.state != null && html`<dt>in state</dt><dd>${detail.factors?.length ? html`<span class="chips">${detail.factors.map(([factor, value]) => html`<span class="chip" key=${factor} title=${sources(of, factor).join(", ")}>${factor} <b>${value ?? "unknown"}</b>${source(scene, of, factor, value) && html` <span class="soft">← ${source(scene, of, factor, value)}</span>`}</span>`)}</span>` : html`<b>${detail.state}</b>`}</dd>`}
      ${detail.observation != null && html`<dt>observed</dt><dd><b>${detail.observation}</b></dd>`}
      ${detail.tally?.length > 0 && html`<dt>so far</dt><dd class="number">${detail.tally.map(([name, count]) => `${name} ${count.toLocaleString("en")} ${count === 1 ? "time" : "times"}`).join(", ")}</dd>`}
      ${detail.reward != null && html`<dt>expected reward</dt><dd class="number">${number(detail.reward)}</dd>`}
      ${detail.value != null && html`<dt>expected return</dt><dd class="number">${number(detail.value)}</dd>`}
      ${detail.search && html`<dt>search</dt><dd>${detail.search}</dd>`}
      ${ended.length > 0 && html`<dt>actions ended</dt><dd class="number">${ended.map(([word, count]) => `${count.toLocaleString("en")} ${word.replace("_", " ")}`).join(", ")}</dd>`}
    </dl>
    ${detail.belief && html`<${Belief} belief=${detail.belief} />`}
    ${detail.observations?.length > 0 && html`<div><h3>the last observations</h3><ol class="heard number">${[...detail.observations].reverse().map(([time, name]) => html`<li key=${time}><span class="soft">${clock(time)}</span> ${name}</li>`)}</ol></div>`}
    <div class="commands"><button disabled=${lost} onClick=${ask} title="w">Why this action?</button>
      ${control && ["start", "stop", "reset", "release"].map((word) => html`<button key=${word} disabled=${lost || hinders(word, each)} title=${hinders(word, each)} onClick=${() => command(word, path)}>${word}</button>`)}</div>
  <//>`;
}

// Why a command would do nothing now; null where it does something.
function hinders(word, { mode }) {
  if (word === "start" && mode === "deciding") return "it decides already";
  if (word !== "start" && word !== "release" && mode === "stopped") return word === "stop" ? "it is stopped already" : "it is stopped: a start begins a new episode";
  return word === "release" && mode !== "safe" ? "it is not safe: there is nothing to release it from" : null;
}

// The predicates that tell a factor of the state.
const sources = (of, factor) => of.factors?.find((each) => each.name === factor)?.told_by ?? [];

// The predicate that tells a factor its value: the only one, or the one that stands for the value; and what tells that one.
function source(scene, of, factor, value) {
  const names = sources(of, factor), { symbols } = of.factors?.find((each) => each.name === factor) ?? {};
  const name = names.length === 1 ? names[0] : symbols?.length === names.length ? names[symbols.indexOf(value)] : null;
  if (!name) return null;
  const known = feeding(scene, of).map((place) => scene.predicates[place]).find((each) => each.name === name || each.name.endsWith(`: ${name}`) || each.name.endsWith(`/${name}`));
  const [, teller] = /^(told by [^,]*)/.exec(known?.definition ?? "") ?? [];
  return teller ? `${name}, ${teller}` : name;
}

function Belief({ belief }) {
  const states = belief.top.filter(([, chance]) => chance >= 0.0005);
  return html`<div>
    <h3>belief over ${belief.states.toLocaleString("en")} states</h3><p class="soft">${sureness(belief)}</p>
    ${(belief.marginals ?? []).length === 0 || belief.states <= 12
      ? states.slice(0, belief.octaves ? 4 : states.length).map(([state, chance]) => html`<${Bar} key=${state} label=${state} share=${chance} text=${percent(chance)} />`) : null}
    ${belief.octaves && (belief.marginals ?? []).length === 0 ? html`<${Octaves} octaves=${belief.octaves} />`
      : (belief.marginals ?? []).length === 0 && belief.rest > 0.0005 && html`<${Bar} rest label=${`${(belief.states - belief.top.length).toLocaleString("en")} others`} share=${belief.rest} text=${percent(belief.rest)} />`}
    ${belief.grid && html`<${Cells} grid=${belief.grid} />`}
    ${(belief.marginals ?? []).filter((each) => !belief.grid || ![belief.grid.down, belief.grid.across].includes(each.factor)).map((each) => html`<div class="factor" key=${each.factor}><h3>${each.factor}</h3>
      ${each.symbols.map((symbol, place) => [symbol, each.values[place]]).filter(([, chance], _, all) => all.length <= 6 || chance >= 0.0005)
        .sort((one, two) => (each.symbols.length > 6 ? two[1] - one[1] : 0)).slice(0, 8)
        .map(([symbol, chance]) => html`<${Bar} key=${symbol} label=${symbol} share=${chance} text=${percent(chance)} />`)}
      ${each.rest > 0.0005 && html`<${Bar} rest label="others" share=${each.rest} text=${percent(each.rest)} />`}</div>`)}
  </div>`;
}

// Of many states: how much of the belief is on states that are so likely each.
function Octaves({ octaves }) {
  const all = octaves.reduce((sum, [, , mass]) => sum + mass, 0);
  let below = 0;   // what is on the least likely ones, which are left out
  const bins = octaves.filter(([, , mass]) => (below += mass) > 0.001 * all).map(([upper, states, mass]) => [upper / 2, upper, mass, `${states.toLocaleString("en")} ${states === 1 ? "state" : "states"} with ${percent(upper / 2)} to ${percent(upper)} each: ${percent(mass)} together`]);
  return html`<div><h3>where the belief lies, by how likely each state is</h3><${Histogram} bins=${bins} format=${(value) => `${Number((100 * value).toPrecision(1))} %`} label=${bins.map(([, , , text]) => text).join("; ")} /></div>`;
}

function Cells({ grid }) {
  const most = Math.max(...grid.values, 1e-9);
  return html`<div><h3>${grid.down} by ${grid.across}</h3><div class="cells" role="img" aria-label=${`belief over ${grid.rows} by ${grid.columns} cells; the likeliest has ${percent(most)}`}
      style=${`grid-template-columns:repeat(${grid.columns},1fr)`}>
    ${grid.values.map((chance, place) => html`<span key=${place} style=${chance > 0 ? `background:color-mix(in srgb, var(--mark) ${Math.round(8 + (72 * chance) / most)}%, var(--paper))` : ""}
      title=${`row ${Math.floor(place / grid.columns)}, column ${place % grid.columns}: ${percent(chance)}`}>${chance >= 0.01 && grid.columns <= 16 ? Math.round(100 * chance) : ""}</span>`)}
  </div></div>`;
}

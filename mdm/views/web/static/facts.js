// Predicates, faults, the team, and what is counted.
import { html, useState } from "./vendor/htm-preact.js";
import { Histogram } from "./bars.js";
import { VirtualList } from "./list.js";
import { Panel } from "./panel.js";
import { clock, feeding, latency, seconds } from "./words.js";

const VALUES = new Map([[true, ["●", "true", "deciding"]], [false, ["○", "false", "stopped"]], [null, ["?", "unknown", "waiting"]]]);

const DIVIDER = -1;

// Those that the chosen ensemble decides on come first.
export function Predicates({ scene, frame, path, lost, control, sense }) {
  const [sought, seek] = useState("");
  const [only, show] = useState(false);
  const isShown = (place) => scene.predicates[place].name.toLowerCase().includes(sought.toLowerCase()) && (!only || frame.predicates[place] !== false);
  const first = feeding(scene, scene.ensembles.find((each) => each.path === path));
  const feeds = new Set(first);
  const mine = first.filter(isShown), others = scene.predicates.map((_, place) => place).filter((place) => !feeds.has(place) && isShown(place));
  if (!scene.predicates.length && scene.source === "live") return null;
  const places = mine.length && others.length ? [...mine, DIVIDER, ...others] : [...mine, ...others];
  const row = (index, style) => {
    const place = places[index];
    if (place === DIVIDER) return html`<div class="row divider soft" role="listitem" key="divider" style=${style}>↑ ${path} decides on these; ↓ the others</div>`;
    const of = scene.predicates[place];
    const [sign, word, mark] = VALUES.get(frame.predicates[place] ?? null);
    return html`<div class="row" role="listitem" key=${of.name} style=${style} title=${of.definition}>
      <span class=${`sign ${mark}`} aria-hidden="true">${sign}</span><span class="name">${of.name}</span><span class=${mark}>${word}</span>
      <span class="grow soft">${of.definition}</span>
      ${control && of.settable && html`<button disabled=${lost} onClick=${() => sense(of.name, frame.predicates[place] !== true)}>set ${frame.predicates[place] === true ? "false" : "true"}</button>`}
      <span class="soft number">${seconds(frame.time - (frame.changed[place] ?? frame.time))}</span></div>`;
  };
  const count = (value) => frame.predicates.filter((each) => each === value).length;
  return html`<${Panel} name="Predicates" aside=${scene.predicates.length > 0 && html`<span class="soft number">● ${count(true)} true, ○ ${count(false)} false, ? ${count(null)} unknown</span>`}>
    ${scene.predicates.length === 0 ? html`<p class="empty">Neither the record nor a replay of it tells any.</p>` : html`
    ${scene.predicates.length > 8 && html`<div class="commands"><input type="search" placeholder="Find" aria-label="Find a predicate" value=${sought} onInput=${(event) => seek(event.currentTarget.value)} />
      <button aria-pressed=${only} onClick=${() => show(!only)}>not the false ones</button></div>`}
    <${VirtualList} count=${places.length} height=${control ? 38 : 28} row=${row} label="Predicates" tall=${252} />`}
  <//>`;
}

const SOURCES = 3;

// Faults of a kind that say the same, but for numbers, are one, of however many sources.
export function Faults({ faults, frame, go }) {
  const grouped = new Map();
  for (const each of faults) {
    const key = `${each.name} ${each.detail.replace(/\d+(\.\d+)?/g, "#")}`;
    const known = grouped.get(key) ?? { count: 0, first: each.time, sources: new Set() };
    grouped.set(key, { ...known, ...each, key, count: known.count + 1, sources: known.sources.add(each.source) });
  }
  const newest = [...grouped.values()].sort((one, two) => two.time - one.time).slice(0, 100);
  const when = ({ time }) => (go ? html`<button onClick=${() => go(time)}>at ${clock(time)}</button>` : `${seconds(Math.max(0, frame.time - time))} ago`);
  const who = ({ sources }) => `${[...sources].slice(0, SOURCES).join(", ")}${sources.size > SOURCES ? ` and ${(sources.size - SOURCES).toLocaleString("en")} more` : ""}`;
  return html`<${Panel} name="Faults" aside=${faults.length > 0 && html`<span class="soft number">${faults.length.toLocaleString("en")}${grouped.size < faults.length ? `, of ${grouped.size} ${grouped.size === 1 ? "kind" : "kinds"}` : ""}</span>`}>
    <div class="scrolls" tabindex="0" role="region" aria-label="List of faults">
    ${newest.length === 0 && html`<p class="empty">There were none.</p>`}
    ${newest.map((each) => html`<div class="fault" key=${each.key}>
      <p><b>⚠ ${each.name}</b>${each.count > 1 && html` <b class="number">×${each.count.toLocaleString("en")}</b>`} <span class="soft" title=${[...each.sources].join(", ")}>${who(each)}</span> <span class="soft number">${when(each)}${each.count > 1 ? `, since ${clock(each.first)}` : ""}</span></p>
      <p>${each.detail}</p>${each.remedy && html`<p class="remedy">${each.remedy}</p>`}</div>`)}
    </div><//>`;
}

const LABELLED = 6;   // Links up to which each has its age and its loss beside it.

// The agents and their links. What a link is like each of its ends tells; the worse is drawn.
function linksOf(entries) {
  const agents = new Map(), links = new Map();
  const me = entries.find(([, facts]) => facts.is === "this agent");
  for (const [of, facts] of entries) {
    const [, agent, teller] = /^agent (\S+)(?: \((.*)\))?$/.exec(of) ?? [];
    if (!agent) continue;
    const from = teller ?? (facts.process ? null : /^agent (\S+)/.exec(me?.[0] ?? "")?.[1]);
    if (!agents.has(agent)) agents.set(agent, { leads: false, gone: false });
    if (facts.process) agents.get(agent).gone = facts.process;
    if (!facts.link || !from || from === agent) continue;
    const pair = [from, agent].sort().join(" - "), known = links.get(pair);
    const told = { ends: [from, agent], lost: facts.link !== "live", text: [facts["last heard"] && `heard ${facts["last heard"]}`, facts["round trip"] && `${facts["round trip"]} there and back`, facts["messages lost"] && !facts["messages lost"].startsWith("0 ") && `${facts["messages lost"]} messages lost`].filter(Boolean) };
    links.set(pair, !known ? { ...told, texts: [`${from} ← ${agent}: ${[facts.link, ...told.text].join(", ")}`] }
      : { ...(told.lost || told.text.length > known.text.length ? told : known), lost: told.lost || known.lost, texts: [...known.texts, `${from} ← ${agent}: ${[facts.link, ...told.text].join(", ")}`] });
  }
  for (const [of, facts] of entries) if (of.startsWith("ensemble ") && agents.has(facts["led by"])) agents.get(facts["led by"]).leads = true;
  return { agents, links: [...links.values()] };
}

function Links({ agents, links }) {
  const names = [...agents.keys()], wide = 360, tall = names.length < 3 ? 130 : 240;
  const at = (name) => { const turn = (2 * Math.PI * names.indexOf(name)) / names.length - (names.length < 3 ? Math.PI : Math.PI / 2); return [wide / 2 + 125 * Math.cos(turn), tall / 2 + (tall / 2 - 34) * Math.sin(turn)]; };
  return html`<svg class="links" viewBox=${`0 0 ${wide} ${tall}`} role="img" aria-label=${links.map(({ ends, lost, text }) => `${ends.join(" and ")}: ${[lost ? "lost" : "live", ...text].join(", ")}`).join("; ")}>
    ${links.map(({ ends, lost, text, texts }) => { const [[x, y], [to, down]] = ends.map(at); const words = [lost ? "✕ lost" : "", ...text].filter(Boolean);
      const share = names.length === 4 && ends.every((end) => names.indexOf(end) % 2 === 0) ? 0.36 : 0.5;   // Of two links that cross, one is named beside the other.
      return html`<g key=${ends.join()} class=${lost ? "cut" : ""}><title>${texts.join("\n")}</title><line x1=${x} y1=${y} x2=${to} y2=${down} />
        ${links.length <= LABELLED && words.map((word, place) => html`<text class="link" x=${x + share * (to - x)} y=${y + share * (down - y) + 12 * (place - (words.length - 1) / 2) + 3}>${word}</text>`)}</g>`; })}
    ${names.map((name) => { const [x, y] = at(name), { leads, gone } = agents.get(name);
      return html`<g key=${name} class=${gone ? "gone" : ""}><title>${`${name}${gone ? ` ${gone}` : ""}`}</title><circle cx=${x} cy=${y} r="9" />${leads && html`<circle class="leads" cx=${x} cy=${y} r="13" />`}<text x=${x} y=${y < tall / 2 - 1 ? y - 18 : y + 27}>${gone ? "✕ " : ""}${name}${leads ? ", leads" : ""}</text></g>`; })}
  </svg>`;
}

const FACTS = ["this agent is", "led by", "the leader's term", "episode", "step", "steps committed"];

export function Team({ team }) {
  const entries = Object.entries(team ?? {});
  if (!entries.length) return null;
  const { agents, links } = linksOf(entries);
  const ensembles = entries.filter(([of]) => of.startsWith("ensemble ")), messages = entries.filter(([of]) => of.startsWith("messages"));
  const shown = FACTS.filter((fact) => ensembles.some(([, facts]) => fact in facts));
  return html`<${Panel} name="Team" aside=${html`<span class="soft number">${agents.size} agents, ${links.filter((each) => each.lost).length} of ${links.length} links lost</span>`}>
    ${agents.size > 0 && html`<${Links} agents=${agents} links=${links} />`}
    ${ensembles.length > 0 && html`<div class="across" tabindex="0" role="region" aria-label="Ensembles of the team"><table><thead><tr><th scope="col">ensemble</th>${shown.map((fact) => html`<th scope="col" key=${fact}>${{ "this agent is": "it is", "the leader's term": "term" }[fact] ?? fact}</th>`)}</tr></thead>
      <tbody class="number">${ensembles.map(([of, facts]) => html`<tr key=${of}><td>${of.slice(9)}</td>${shown.map((fact) => html`<td key=${fact}>${facts[fact] ?? ""}</td>`)}</tr>`)}</tbody></table></div>`}
    ${messages.map(([of, facts]) => html`<p class="soft number" key=${of}>${of}: ${Object.entries(facts).map(([key, value]) => `${key} ${value}`).join(", ")}</p>`)}
    ${ensembles.some(([, facts]) => facts["the leader's term"]) && html`<p class="soft legend">A step is one decision of the team on one joint input, and committed when no later leader can decide otherwise. One agent leads for a term; each further term has the next number.</p>`}
  <//>`;
}

export function Counts({ statistics, path }) {
  if (!statistics) return null;
  const spread = statistics.latencies?.[path];
  const counts = Object.entries(statistics.counts ?? {});
  if (!counts.length && !spread?.count) return null;
  const octaves = new Map();
  for (const [upper, count] of spread?.buckets ?? []) {
    const octave = Math.ceil(Math.log2(upper * 1e9) * 2) / 2;
    octaves.set(octave, (octaves.get(octave) ?? 0) + count);
  }
  const bins = [...octaves].map(([octave, count]) => { const [from, to] = [2 ** (octave - 0.5) / 1e9, 2 ** octave / 1e9]; return [from, to, count, `${latency(from)} to ${latency(to)}: ${count.toLocaleString("en")}`]; });
  return html`<${Panel} name="Counts" title="Latency and counts">
    ${spread?.count > 0 && html`<div><h3>from stimulus to callback <span class="soft number">${spread.count.toLocaleString("en")}: half within ${latency(spread.half)}, 99 % within ${latency(spread.most)}, at most ${latency(spread.maximum)}</span></h3>
      <${Histogram} bins=${bins} format=${latency} label=${bins.map(([, , , text]) => text).join("; ")} /></div>`}
    ${counts.length > 0 && html`<dl>${counts.map(([key, value]) => html`<dt key=${key}>${key}</dt><dd class="number">${value.toLocaleString("en")}</dd>`)}</dl>`}
  <//>`;
}

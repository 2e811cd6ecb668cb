// Predicates, faults, the team, and what is counted.
import { html, useState } from "./vendor/htm-preact.js";
import { VirtualList } from "./list.js";
import { Panel } from "./panel.js";
import { clock, feeding, latency, seconds } from "./words.js";
import { Bar } from "./ensembles.js";

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
    ${scene.predicates.length === 0 ? html`<p class="empty">${scene.source === "record" ? "The record tells none." : "There are none."}</p>` : html`
    ${scene.predicates.length > 8 && html`<div class="commands"><input type="search" placeholder="Find" aria-label="Find a predicate" value=${sought} onInput=${(event) => seek(event.currentTarget.value)} />
      <button aria-pressed=${only} onClick=${() => show(!only)}>not the false ones</button></div>`}
    <${VirtualList} count=${places.length} height=${control ? 38 : 28} row=${row} label="Predicates" tall=${252} />`}
  <//>`;
}

export function Faults({ faults, frame, go }) {
  const grouped = new Map();
  for (const each of faults) {
    const key = `${each.source} ${each.name} ${each.detail}`;
    const known = grouped.get(key);
    if (known) { known.count += 1; known.time = each.time; } else grouped.set(key, { ...each, count: 1, first: each.time });
  }
  const newest = [...grouped.values()].sort((one, two) => two.time - one.time).slice(0, 100);
  return html`<${Panel} name="Faults" aside=${faults.length > 0 && html`<span class="soft number">${faults.length.toLocaleString("en")}, the newest first</span>`}>
    <div class="scrolls" tabindex="0" role="region" aria-label="List of faults">
    ${newest.length === 0 && html`<p class="empty">There were none.</p>`}
    ${newest.map((each) => html`<div class="fault" key=${`${each.source} ${each.name} ${each.detail}`}>
      <p><b>⚠ ${each.name}</b> <span class="soft">${each.source}</span> <span class="soft number">${go ? html`<button onClick=${() => go(each.time)}>at ${clock(each.time)}</button>` : `${seconds(Math.max(0, frame.time - each.time))} ago`}${each.count > 1 ? `, ${each.count} times` : ""}</span></p>
      <p>${each.detail}</p>${each.remedy && html`<p class="remedy">${each.remedy}</p>`}</div>`)}
    </div><//>`;
}

export function Team({ team }) {
  const entries = Object.entries(team ?? {});
  if (!entries.length) return null;
  return html`<${Panel} name="Team"><table><tbody>
    ${entries.map(([of, facts]) => html`<tr key=${of}><th scope="row">${({ lost: "✕ ", "none yet": "○ " })[facts.link] ?? (facts.link || facts.is ? "● " : "")}${of}</th><td>${Object.entries(facts).map(([key, value]) => `${key} ${value}`).join(", ")}</td></tr>`)}
  </tbody></table>
  ${entries.some(([, facts]) => facts["the leader's term"]) && html`<p class="soft legend">A step is one decision of the team on one joint input, and committed when no later leader can decide otherwise. One agent leads for a term; each further term has the next number.</p>`}
  <//>`;
}

export function Counts({ statistics, path }) {
  if (!statistics) return null;
  const spread = statistics.latencies?.[path];
  const counts = Object.entries(statistics.counts ?? {});
  const most = spread ? Math.max(...spread.buckets.map(([, count]) => count), 1) : 1;
  if (!counts.length && !spread?.count) return null;
  const octaves = new Map();
  for (const [upper, count] of spread?.buckets ?? []) {
    const octave = Math.ceil(Math.log2(upper * 1e9) * 2) / 2;
    octaves.set(octave, (octaves.get(octave) ?? 0) + count);
  }
  const tallest = Math.max(...octaves.values(), 1);
  return html`<${Panel} name="Counts" title="Latency and counts">
    ${spread?.count > 0 && html`<div><h3>from stimulus to callback <span class="soft number">${spread.count.toLocaleString("en")}: half within ${latency(spread.half)}, 99 % within ${latency(spread.most)}, at most ${latency(spread.maximum)}</span></h3>
      ${[...octaves].slice(-12).map(([octave, count]) => html`<${Bar} key=${octave} label=${`up to ${latency(2 ** octave / 1e9)}`} share=${count / tallest} text=${count.toLocaleString("en")} />`)}</div>`}
    ${counts.length > 0 && html`<dl>${counts.map(([key, value]) => html`<dt key=${key}>${key}</dt><dd class="number">${value.toLocaleString("en")}</dd>`)}</dl>`}
  <//>`;
}

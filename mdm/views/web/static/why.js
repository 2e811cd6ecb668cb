// Why an action was decided.
import { html, useEffect, useRef } from "./vendor/htm-preact.js";
import { Bar } from "./ensembles.js";
import { Panel } from "./panel.js";
import { clock, number } from "./words.js";

// Args: why: what is told; decides: of the ensemble now, the number and the time of its last decision.
export function Why({ scene, why, decides }) {
  const { why: told, decided, question } = why;
  const box = useRef(null);
  useEffect(() => box.current?.scrollIntoView({ block: "nearest" }), [question]);
  const isEarlier = scene.source === "live" && told?.epoch >= 0 ? told.epoch !== decides.epoch : decided !== decides.time;
  const values = (told?.values ?? []).filter(([, value]) => value != null);
  const least = Math.min(...values.map(([, value]) => value));
  const span = Math.max(...values.map(([, value]) => value)) - least || 1;
  const title = `Why${told?.epoch >= 0 ? ` decision ${told.epoch}` : ""}${decided == null ? "" : ` at ${clock(decided)}`}`;
  return html`<${Panel} name="Why" label=${title} aside=${isEarlier && html`<span class="soft">since then it has decided again</span>`}>
    <div ref=${box}>${told ? html`<pre class="why">${told.text}</pre>
    ${values.length > 1 && html`<h3>values of the actions</h3>${values.slice(0, 12).map(([action, value]) => html`<${Bar} key=${action} label=${action} share=${0.04 + (0.96 * (value - least)) / span} text=${number(value)} />`)}`}`
    : html`<p class="empty">Nothing tells why: this version explains no decisions of this kind.</p>`}</div><//>`;
}

// The policy as a picture. The program lays it out, for files as for the page; here its paths and texts are drawn.
import { html, useEffect, useRef, useState } from "./vendor/htm-preact.js";
import { Panel } from "./panel.js";
import { tint } from "./words.js";

const PAUSE = 300, PATIENCE = 5_000;   // Milliseconds between two pictures, and until one is asked for again.
const LINE = 15, FEW = 50;             // Pixels of a line; ensembles up to which a picture follows what runs in each.
const WIDE = 560, LEAST = 0.75;        // Pixels from which on a picture has all of the width, and to which share of its size it shrinks.

// Args: told: the last pictures that came; say: sends a message.
export function Policy({ scene, frame, path, told, say, lost }) {
  const mine = told?.ensemble === path ? told : null;
  const isWide = (mine?.pictures ?? []).some((each) => each.width > WIDE);
  return html`<${Panel} name="Policy" label=${`Policy of ${path}`} wide=${isWide}>
    <${Pictures} key=${path} scene=${scene} frame=${frame} path=${path} told=${mine} say=${say} lost=${lost} /><//>`;
}

// Asks for another picture where another decision was made, or another node was opened.
function Pictures({ scene, frame, path, told, say, lost }) {
  const [opened, open] = useState([]);
  const [, again] = useState(0);
  const asked = useRef({ key: null, since: -PAUSE, before: undefined });
  const place = scene.ensembles.findIndex((each) => each.path === path);
  const running = scene.ensembles.length > FEW ? [] : frame.ensembles.map((each) => (each.live ?? []).map((life) => life.action));
  const key = JSON.stringify([opened, frame.ensembles[place]?.decisions, frame.details?.[path]?.decided, running]);
  useEffect(() => {
    if (lost || asked.current.key === key) return undefined;
    const { since, before } = asked.current, age = performance.now() - since, isDue = age >= PAUSE && (told !== before || age >= PATIENCE);
    if (!isDue) {
      const timer = setTimeout(() => again(key), Math.max(PAUSE - age, 50));
      return () => clearTimeout(timer);
    }
    asked.current = { key, since: performance.now(), before: told };
    say({ say: "draw", ensemble: path, time: scene.source === "record" ? frame.time : null, opened });
    return undefined;
  });
  if (!told) return html`<p class="empty">It is being drawn.</p>`;
  return told.pictures.map((picture, number) => html`<div class="pictured" key=${number}>
    <h3>${picture.title}</h3>
    ${(picture.remarks ?? []).map((text) => html`<p class="soft legend" key=${text}>${text}</p>`)}
    ${picture.shapes && html`<${Drawing} picture=${picture} colour=${(action) => tint(scene, path, action)} open=${(node) => open([...opened, node])} />`}
  </div>`);
}

function Drawing({ picture, colour, open }) {
  const { width, height, title, shapes } = picture;
  const box = useRef(null), lit = shapes.filter((shape) => shape.kind === "box" && shape.lit).map((shape) => shape.y);
  const middle = lit.length ? (Math.min(...lit) + Math.max(...lit)) / 2 / height : 0;
  useEffect(() => { box.current.scrollTop = middle * box.current.scrollHeight - box.current.clientHeight / 2; }, [middle]);
  return html`<div class="drawing scrolls" ref=${box} tabindex="0" role="region" aria-label="Policy, which scrolls"><svg class="policy" role="group" aria-label=${title} viewBox=${`0 0 ${width} ${height}`} style=${`width:min(${width}px, max(100%, ${LEAST * width}px))`}>
    <defs>${["", "lit"].map((kind) => html`<marker key=${kind} id=${`tip${kind}`} class=${kind} viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" markerHeight="8" markerUnits="userSpaceOnUse" orient="auto"><path d="M0 0L8 4L0 8z" /></marker>`)}</defs>
    ${shapes.map((shape, place) => html`<${Shape} key=${place} ...${shape} colour=${colour} open=${open} />`)}</svg></div>`;
}

function Shape({ kind, path, x = 0, y = 0, text = [], title, action, lit, opens, colour, open }) {
  const press = (event) => {
    if (event.type === "keydown" && event.key !== "Enter" && event.key !== " ") return;
    event.preventDefault();
    event.stopPropagation();
    open(opens);
  };
  const button = opens == null ? {} : { role: "button", tabindex: 0, "aria-label": title, onClick: press, onKeyDown: press };
  return html`<g class=${`${kind}${lit ? " lit" : ""}${action ? " inked" : ""}`} ...${button}>
    ${title && html`<title>${title}</title>`}
    ${path && html`<path d=${path} style=${action ? `fill:var(--${colour(action)})` : null} />`}
    ${text.map((line, place) => html`<text key=${place} x=${x} y=${y + LINE * (place - text.length / 2) + 11.5}>${line}</text>`)}
  </g>`;
}

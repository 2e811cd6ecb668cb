// The frame of each panel, which can be closed and stays so in this browser; and where panels stand.
import { html, useState } from "./vendor/htm-preact.js";

const KEY = "closed panels";
const ROW = 2, GAP = 10;         // Pixels of a row of the grid, and between panels.
const WIDTH = 400, COLUMNS = 4;  // Pixels that a column has at least, and how many columns there are at most.
const UNEVEN = 40;               // Pixels by which the columns have to become shorter before panels change their places.

function closedOnes() {
  try { return new Set(JSON.parse(localStorage.getItem(KEY) ?? "[]")); } catch { return new Set(); }
}

// Args: name: by which it is remembered; label: for those who do not see it; title: its heading; aside: what stands beside that.
export function Panel({ name, label = name, title = label, aside, wide, kind = "", children }) {
  const [isClosed, close] = useState(() => closedOnes().has(name));
  const turn = () => {
    const known = closedOnes();
    if (isClosed) known.delete(name); else known.add(name);
    localStorage.setItem(KEY, JSON.stringify([...known]));
    close(!isClosed);
  };
  return html`<section class=${`panel ${kind}${wide ? " wide" : ""}`} aria-label=${label}>
    <div class="head"><h2>${title}</h2>${!isClosed && aside}<button class="fold" aria-expanded=${!isClosed} aria-label=${`${isClosed ? "Open" : "Close"} ${name}`} onClick=${turn}>${isClosed ? "+" : "–"}</button></div>
    ${!isClosed && children}</section>`;
}

const columns = new WeakMap();   // In which column each panel stands.

// Each panel stands below the shortest column, and keeps its place for as long as the columns are about as tall as each other.
// Those that take all of the width stand above or below the columns, so that these have no holes.
function arrange(grid) {
  const all = [...grid.querySelectorAll(".panel")], isBelow = (box, place) => box.classList.contains("wide") && all.slice(0, place).some((other) => !other.classList.contains("wide"));
  const boxes = [...all.filter((box, place) => !isBelow(box, place)), ...all.filter(isBelow)];
  const count = Math.max(1, Math.min(COLUMNS, Math.floor(grid.clientWidth / WIDTH)));
  const rows = boxes.map((box) => Math.ceil((box.offsetHeight + GAP) / ROW));
  const placed = (keeps) => {
    const tall = Array(count).fill(0);
    const places = boxes.map((box, place) => {
      const isWide = box.classList.contains("wide"), known = keeps ? columns.get(box) ?? count : count;
      const column = isWide ? 0 : known < count ? known : tall.indexOf(Math.min(...tall));
      const row = isWide ? Math.max(...tall) : tall[column];
      if (isWide) tall.fill(row + rows[place]); else tall[column] = row + rows[place];
      return [column, row];
    });
    return { places, tallest: Math.max(...tall) };
  };
  const fresh = placed(false), kept = placed(true);
  const { places } = (kept.tallest - fresh.tallest) * ROW > UNEVEN || grid.style.getPropertyValue("--columns") !== String(count) ? fresh : kept;
  grid.style.setProperty("--columns", count);
  boxes.forEach((box, place) => {
    const [column, row] = places[place], isWide = box.classList.contains("wide");
    if (!isWide) columns.set(box, column);
    box.style.gridArea = `${row + 1} / ${isWide ? 1 : column + 1} / span ${rows[place]} / ${isWide ? -1 : "auto"}`;
  });
}

let due = false;
const watch = new ResizeObserver(() => {
  if (due) return;
  due = true;
  requestAnimationFrame(() => { due = false; settle(); });
});

// Puts all panels into their places, and again whenever one becomes larger or smaller.
export function settle() {
  const grid = document.querySelector(".panels");
  if (!grid) return;
  for (const box of [grid, ...grid.querySelectorAll(".panel")]) watch.observe(box);
  arrange(grid);
}

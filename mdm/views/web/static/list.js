// A list that draws the rows in sight alone: a thousand cost no more than twenty.
import { html, useEffect, useRef, useState } from "./vendor/htm-preact.js";

export function VirtualList({ count, height, row, label, selected, choose, role = "list", tall = 352 }) {
  const box = useRef(null);
  const [top, setTop] = useState(0);
  const shown = Math.min(tall, count * height);
  useEffect(() => {
    if (selected == null || selected < 0 || !box.current) return;
    const at = selected * height;
    if (at < box.current.scrollTop) box.current.scrollTop = at;
    else if (at + height > box.current.scrollTop + box.current.clientHeight) {
      box.current.scrollTop = at + height - box.current.clientHeight;
    }
  }, [selected]);
  const first = Math.max(0, Math.floor(top / height) - 3);
  const last = Math.min(count, Math.ceil((top + shown) / height) + 3);
  const keys = (event) => {
    if (!choose || event.ctrlKey || event.metaKey || event.altKey) return;
    const steps = { ArrowDown: 1, ArrowUp: -1, PageDown: 10, PageUp: -10, Home: -count, End: count };
    if (!(event.key in steps)) return;
    event.preventDefault();
    event.stopPropagation();
    choose(Math.max(0, Math.min(count - 1, (selected ?? 0) + steps[event.key])));
  };
  const rows = [];
  for (let place = first; place < last; place += 1) rows.push(row(place, `top:${place * height}px;height:${height}px`));
  return html`<div class="list" ref=${box} role=${role} aria-label=${label} tabindex="0" style=${`height:${shown}px`}
      aria-activedescendant=${selected == null || selected < first || selected >= last ? null : `${role}-${selected}`}
      onScroll=${(event) => setTop(event.currentTarget.scrollTop)} onKeyDown=${keys}>
    <div class="inner" role="presentation" style=${`height:${count * height}px`}>${rows}</div>
  </div>`;
}

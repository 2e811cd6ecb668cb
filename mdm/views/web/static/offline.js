// In place of the socket, in a page that is one file: it answers from the record that stands in it.

const packed = document.getElementById("record");
const bytes = Uint8Array.from(atob(packed.textContent), (each) => each.charCodeAt(0));
const record = JSON.parse(await new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text());
packed.remove();

// The last entry of a list by a time; the first one where there is none.
function by(list, time) {
  let low = 0, high = list.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (list[middle].time <= time + 1e-9) low = middle + 1; else high = middle;
  }
  return list[Math.max(0, low - 1)];
}

// What is known of an ensemble's last decision by a time, or of one before.
function looked(ensemble, time) {
  const last = by(record.close[ensemble]?.looks ?? [], time), place = record.scene.ensembles.findIndex((each) => each.path === ensemble);
  if (!last) return { why: record.why, pictures: [] };
  const decisions = (at) => by(record.frames, at).ensembles[place].decisions, isOld = decisions(last.time) !== decisions(time);
  const remark = `This is the decision at ${last.time.toFixed(2)} s: this file draws some of many.`;
  return {
    why: isOld ? record.why : last.why,
    pictures: (last.pictures ?? []).map((each) => ({
      ...each, remarks: [...(each.remarks ?? []), ...(isOld ? [remark] : [])], shapes: each.shapes?.map((shape) => ({ ...shape, opens: null })),
    })),
  };
}

function steps(kind) {
  const last = new Map(), found = [];
  for (const each of record.events) {
    if (kind === "change" && each.kind === "decision") {
      if (last.get(each.source) !== each.name) found.push(each.time);
      last.set(each.source, each.name);
    } else if (each.kind === kind && (kind !== "judgement" || each.status === "begins")) found.push(each.time);
  }
  return found;
}

export class Connection {
  constructor(told, changed) {
    const tell = (message) => setTimeout(() => told(message));
    this.tell = tell;
    setTimeout(() => { changed("open", ""); tell({ scene: record.scene }); });
  }

  say(message) {
    const { say, time, ensemble } = message;
    if (say === "at") this.frame(time);
    else if (say === "step") {
      const times = steps(message.kind), found = message.back ? times.findLast((each) => each < time - 1e-9) : times.find((each) => each > time + 1e-9);
      this.frame(found ?? time);
    } else if (say === "lanes") {
      const { first, last } = record.scene, wanted = new Set([...message.paths, ...message.predicates]);
      this.tell({ lanes: record.events.filter((each) => wanted.has(each.kind === "predicate" ? each.name : each.source) && ["mode", "life", "decision", "predicate"].includes(each.kind)), asked: { ...message, first, last, whole: true } });
    } else if (say === "course") this.tell({ course: record.close[ensemble]?.course ?? null, ensemble, first: message.first, last: message.last });
    else if (say === "why") this.tell({ why: looked(ensemble, time).why, ensemble });
    else if (say === "draw") this.tell({ pictures: looked(ensemble, time).pictures, ensemble });
  }

  frame(time) {
    const told = record.told ? [] : record.events.filter((each) => !["mode", "life", "decision", "predicate"].includes(each.kind));
    record.told = true;
    this.tell({ frame: { ...by(record.frames, time), time }, events: told, cursor: 0 });
  }
}

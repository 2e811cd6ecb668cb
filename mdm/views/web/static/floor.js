// The floor: places, ways, robots with where they head for, and the belief over places.
import { html, useEffect, useRef } from "./vendor/htm-preact.js";
import { Panel } from "./panel.js";
import { colour, percent } from "./words.js";

const pictures = new Map();

function bytes(text) {
  const raw = atob(text);
  const found = new Uint8Array(raw.length);
  for (let place = 0; place < raw.length; place += 1) found[place] = raw.charCodeAt(place);
  return found;
}

function rgb(text) {
  const whole = parseInt(text.slice(1), 16);
  return [(whole >> 16) & 255, (whole >> 8) & 255, whole & 255];
}

function picture(floor, scheme) {
  const known = pictures.get(floor);
  if (known && known.scheme === scheme) return known.canvas;
  const canvas = document.createElement("canvas");
  canvas.width = floor.columns;
  canvas.height = floor.rows;
  const context = canvas.getContext("2d");
  const image = context.createImageData(floor.columns, floor.rows);
  const raster = bytes(floor.raster);
  const wall = rgb(colour("wall")), ground = rgb(colour("ground")), paper = rgb(colour("floor"));
  const tints = [0, 1, 2, 3, 4, 5, 6].map((place) => rgb(colour(`a${place}`)).map((part, index) => Math.round(0.18 * part + 0.82 * paper[index])));
  for (let place = 0; place < raster.length; place += 1) {
    const value = raster[place];
    const [red, green, blue] = value === 255 ? wall : value === 0 ? ground : tints[(value - 1) % tints.length];
    image.data.set([red, green, blue, 255], 4 * place);
  }
  context.putImageData(image, 0, 0);
  pictures.set(floor, { scheme, canvas });
  return canvas;
}

// The probability of each place, from the first factor or belief whose symbols are places.
export function overPlaces(frame, floor) {
  const names = new Set(floor.places.map((place) => place.name));
  for (const detail of Object.values(frame.details ?? {})) {
    for (const each of detail.belief?.marginals ?? []) {
      if (each.symbols.filter((symbol) => names.has(symbol)).length > 1) {
        return new Map(each.symbols.map((symbol, place) => [symbol, each.values[place]]));
      }
    }
    const top = (detail.belief?.top ?? []).filter(([state]) => names.has(state));
    if (top.length > 1) return new Map(top);
  }
  return new Map();
}

export function Floor({ floors, frame, scheme }) {
  const robot = frame.robots?.[0];
  const floor = floors.find((each) => each.name === (robot?.floor ?? "")) ?? floors[0];
  const box = useRef(null);
  const chances = overPlaces(frame, floor);
  const told = robot ? `The robot is ${robot.place ? `in ${robot.place}` : "in no place that is known"}${robot.goal ? ` and heads for ${robot.goal}` : ""}.` : "It is not known where the robot is.";
  useEffect(() => draw(box.current, floor, frame, scheme, chances));
  return html`<${Panel} name="Floor" title=${`Floor${floor.name ? ` ${floor.name}` : ""}`} aside=${html`<span>${told}</span>`}>
    <canvas ref=${box} role="img" aria-label=${`${told} ${[...chances].filter(([, chance]) => chance > 0.005).map(([place, chance]) => `${place} ${percent(chance)}`).join(", ")}`}></canvas>
    <p class="soft legend">▲ robot, ◎ where it heads for${chances.size ? ", ● how likely it is where" : ""}</p>
  <//>`;
}

function draw(canvas, floor, frame, scheme, chances) {
  if (!canvas) return;
  const wide = canvas.clientWidth;
  if (!wide) return;
  const scale = Math.min(wide / floor.columns, 520 / floor.rows);
  const ratio = window.devicePixelRatio || 1;
  const width = Math.round(wide * ratio), height = Math.round(floor.rows * scale * ratio);
  if (canvas.width !== width || canvas.height !== height) {
    canvas.width = width;
    canvas.height = height;
    canvas.style.height = `${height / ratio}px`;
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, wide, floor.rows * scale);
  const left = (wide - floor.columns * scale) / 2;
  const at = (row, column) => [left + (column + 0.5) * scale, (row + 0.5) * scale];
  context.imageSmoothingEnabled = scale < 1;
  context.drawImage(picture(floor, scheme), left, 0, floor.columns * scale, floor.rows * scale);
  const places = new Map(floor.places.map((place) => [place.name, place]));
  const ink = colour("ink"), soft = colour("soft"), mark = colour("mark"), paper = colour("paper");
  context.lineWidth = 1;
  context.strokeStyle = soft;
  context.globalAlpha = 0.5;
  for (const way of floor.ways) {
    const [from, to] = [places.get(way.source), places.get(way.target)];
    if (!from || !to) continue;
    context.beginPath();
    context.moveTo(...at(from.row, from.column));
    context.lineTo(...at(to.row, to.column));
    context.stroke();
  }
  context.globalAlpha = 1;
  context.font = `600 ${Math.max(10, Math.min(14, wide / 42))}px system-ui, "DejaVu Sans", sans-serif`;
  context.textAlign = "center";
  // Labels give way to robots, and to each other: above their place, else below it, else farther above.
  const taken = (frame.robots ?? []).filter((robot) => robot.floor === floor.name).map((robot) => { const [x, y] = at(robot.row, robot.column); return [x - 14, y - 14, x + 14, y + 14]; });
  const size = parseFloat(/(\d+(?:\.\d+)?)px/.exec(context.font)[1]);
  const room = (x, y, width) => [x - width / 2 - 2, y - size, x + width / 2 + 2, y + 3];
  const isFree = ([left, top, right, bottom]) => top > 0 && !taken.some((one) => one[0] < right && left < one[2] && one[1] < bottom && top < one[3]);
  for (const place of floor.places) {
    const [x, y] = at(place.row, place.column);
    const chance = chances.get(place.name);
    context.fillStyle = mark;
    if (chance > 0.005) {
      context.globalAlpha = 0.35;
      context.beginPath();
      context.arc(x, y, 6 + 26 * Math.sqrt(chance), 0, 7);
      context.fill();
      context.globalAlpha = 1;
    }
    context.fillStyle = soft;
    context.beginPath();
    context.arc(x, y, 2.5, 0, 7);
    context.fill();
    const label = chance > 0.005 ? `${place.name} ${percent(chance)}` : place.name;
    const width = context.measureText(label).width;
    const middle = Math.max(width / 2 + 3, Math.min(wide - width / 2 - 3, x));
    const line = [y - 7, y + size + 6, y - 26, y + size + 22].find((each) => isFree(room(middle, each, width))) ?? y - 7;
    taken.push(room(middle, line, width));
    context.lineWidth = 3;
    context.strokeStyle = paper;
    context.strokeText(label, middle, line);
    context.fillStyle = ink;
    context.fillText(label, middle, line);
  }
  for (const robot of frame.robots ?? []) {
    if (robot.floor !== floor.name) continue;
    const [x, y] = at(robot.row, robot.column);
    const goal = places.get(robot.goal);
    context.strokeStyle = context.fillStyle = colour("robot");
    if (goal) {
      const [to, down] = at(goal.row, goal.column);
      context.lineWidth = 2;
      context.setLineDash([6, 4]);
      context.beginPath();
      context.moveTo(x, y);
      context.lineTo(to, down);
      context.stroke();
      context.setLineDash([]);
      context.beginPath();
      context.arc(to, down, 8, 0, 7);
      context.stroke();
    }
    context.save();
    context.translate(x, y);
    context.rotate(-robot.yaw);
    context.beginPath();
    context.moveTo(12, 0);
    context.lineTo(-8, 8);
    context.lineTo(-4, 0);
    context.lineTo(-8, -8);
    context.closePath();
    context.fill();
    context.lineWidth = 2;
    context.strokeStyle = paper;
    context.stroke();
    context.restore();
  }
}

// Times, numbers and modes in words, each mode with its sign.

export const SIGNS = { deciding: "▶", safe: "■", stopped: "○", waiting: "…", idle: "–" };

const BETWEEN = /^a pause of .* succeeded$/;   // As a binding has it on purpose, for `then = "decide"`.
const PAUSE = 2;   // Seconds without anything to do that nobody need be told of: a pause between two decisions.

export function standing(frame, now) {
  if (frame.mode === "safe") return "safe";
  if (frame.mode === "deciding" && (frame.waiting ?? []).some((each) => !BETWEEN.test(each))) return "waiting";
  if (frame.mode === "deciding" && frame.idle != null && now - frame.idle >= PAUSE) return "idle";
  return frame.mode;
}

// Since when it is as it stands: of one that waits that is not known, for its mode is older.
export function since(frame, now) {
  const how = standing(frame, now);
  return how === "waiting" ? null : how === "idle" ? frame.idle : frame.since;
}

// What an ensemble is called: at the top by its whole path, which names its agent in a team, else by its own name.
export const called = (of) => (of.parent < 0 ? of.path : of.path.slice(of.path.lastIndexOf("/") + 1));

// The places of the predicates that tell a factor of an ensemble's state. In a team a name begins with its agent's.
export function feeding(scene, of) {
  if (!of) return [];
  const names = new Set((of.factors ?? []).flatMap((each) => each.told_by ?? []));
  const mine = (agent) => !agent || of.path === agent || of.path.startsWith(`${agent}/`);
  return scene.predicates.map((_, place) => place).filter((place) => {
    const [, agent, name] = /^(?:(.*?): )?(.*)$/.exec(scene.predicates[place].name);
    return mine(agent) && (names.has(name) || names.has(name.slice(name.lastIndexOf("/") + 1)));
  });
}

// The colour of an action, by name, is the same everywhere. Where all ensembles together have more actions than there are
// colours, each ensemble has its own order.
const COLOURS = 8;
const tints = new WeakMap();
export function tint(scene, path, action) {
  if (!tints.has(scene)) {
    const all = new Set(scene.ensembles.flatMap((each) => each.actions ?? []));
    tints.set(scene, all.size > COLOURS ? new Map() : new Map([["", [...all]]]));
  }
  const known = tints.get(scene), key = known.has("") ? "" : path;
  if (!known.has(key)) known.set(key, [...(scene.ensembles.find((each) => each.path === path)?.actions ?? [])]);
  const names = known.get(key);
  if (!names.includes(action)) names.push(action);
  return `a${names.indexOf(action) % COLOURS}`;
}

// The colour of a state, by its place among those that are drawn: from the other end, so that few have that of an action.
export const stateTint = (place) => `a${(2 * COLOURS - 1 - place) % COLOURS}`;

export function seconds(value) {
  if (value < 0) return "0 s";
  if (value < 10) return `${value.toFixed(1)} s`;
  if (value < 120) return `${Math.floor(value)} s`;
  if (value < 7200) return `${Math.floor(value / 60)} min ${Math.floor(value % 60)} s`;
  return `${Math.floor(value / 3600)} h ${Math.floor((value % 3600) / 60)} min`;
}

// Args: digits: behind the point.
export function clock(value, digits = 1) {
  const whole = Math.max(0, Number(value.toFixed(digits)));
  const part = (number, width = 2) => String(number).padStart(width, "0");
  const hours = Math.floor(whole / 3600);
  const rest = `${part(Math.floor(whole / 60) % 60)}:${(whole % 60).toFixed(digits).padStart(digits ? digits + 3 : 2, "0")}`;
  return hours ? `${hours}:${rest}` : rest;
}

// The digits behind the point of times that lie so many seconds apart.
export const digits = (step) => (String(Number(step.toPrecision(3))).split(".")[1] ?? "").length;

export function number(value) {
  if (value == null) return "";
  const size = Math.abs(value);
  if (size !== 0 && (size < 0.001 || size >= 1e6)) return value.toExponential(2);
  return String(Number(value.toFixed(size < 10 ? 3 : 1)));
}

// How sure a belief is, in words; 2 to the entropy is the number of equally likely states that would be as unsure.
export function sureness({ top, entropy = 0 }) {
  const [state, chance] = top[0] ?? ["nothing", 0], doubt = 2 ** entropy;
  const word = chance >= 0.99 ? "all but certain" : chance >= 0.9 ? "quite sure" : chance >= 0.7 ? "fairly sure" : chance >= 0.5 ? "unsure" : "very unsure";
  return `${word}: ${percent(chance)} for ${state}, as unsure as between ${doubt < 10 ? Number(doubt.toFixed(1)) : Math.round(doubt).toLocaleString("en")} states`;
}

export const percent = (value) => (value >= 0.9995 ? "100 %" : value < 0.001 ? (value > 0 ? "<0.1 %" : "0 %") : `${(100 * value).toFixed(1)} %`);

export function latency(value) {
  const [scale, unit] = value < 1e-3 ? [1e6, "µs"] : value < 1 ? [1e3, "ms"] : [1, "s"];
  return `${Number((scale * value).toPrecision(2))} ${unit}`;
}

export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

// The colour of the line around something of a light colour.
export const edge = (name) => `color-mix(in srgb, ${colour(name)} 55%, ${colour("ink")})`;

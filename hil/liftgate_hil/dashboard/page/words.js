"use strict";
// Commands, and what of them is in force, in the words that the page has for them.

const numberOf = (count, noun) => `${count} ${noun}${count === 1 ? "" : "s"}`;

// A label within a sentence; one that begins with an abbreviation stays.
const inSentence = (label) => (/^[A-Z][a-z]/.test(label) ? label[0].toLowerCase() + label.slice(1) : label);

function withUnit(value, spec) {
  return `${typeof value === "number" ? shownIn(value, spec) : value} ${spec.unit || ""}`.trim();
}

// A fault: its kind, its place, and its values.
function faultWords({ kind, where, ...values }) {
  const spec = about.commands.fault[kind] || { label: kind, keys: {} };
  const each = ([name, value]) => {
    const key = spec.keys[name] || { label: name };
    return key.labels?.length ? value : `${inSentence(key.label)} ${withUnit(value, key)}`;
  };
  return [spec.label, where, ...Object.entries(values).map(each)].filter(Boolean).join(", ");
}

function obstacleWords(obstacle) {
  return Object.entries(obstacle)
    .filter(([name, value]) => name !== "meets" || value !== "closing")
    .map(([name, value]) => {
      const spec = about.commands.obstacle[name];
      return spec ? `${inSentence(spec.label)} ${withUnit(value, spec)}` : `${name} ${value}`;
    })
    .join(", ");
}

// A setting; null: it is cleared.
function settingWords(name, value) {
  const { label, labels, ...spec } = about.commands.set[name];
  if (name === "hand_force_n") return value === null ? "hand let go" : `hand ${withUnit(value, spec)}`;
  if (value === null) return `${inSentence(label)} cleared`;
  return `${inSentence(label)} ${labels.length ? labels[value] : withUnit(value, spec)}`;
}

const CLEARED = {
  obstacle: () => "obstacle removed",
  all: () => "all commands cleared",
  fault: (fault) => `fault cleared: ${faultWords(fault)}`,
  signal: (name) => `signal cleared: ${name}`,
};
const DONE = {
  obstacle: ({ angle_deg: angle, ...rest }) =>
    [`obstacle put at ${text(angle, 2)}°`, obstacleWords(rest)].filter(Boolean).join(", "),
  set: (values) =>
    Object.entries(values)
      .map(([name, value]) => settingWords(name, value))
      .join(", "),
  fault: (fault) => `fault injected: ${faultWords(fault)}`,
  clear: (what) => {
    const [name, one] = typeof what === "string" ? [what] : Object.entries(what)[0];
    return CLEARED[name]?.(one);
  },
};

// What a command has done; those of other kinds the server words.
function doneWords(content, done) {
  const [[kind, what]] = Object.entries(content);
  return DONE[kind]?.(what) ?? done;
}

// What was commanded and is in force.
function inForce({ obstacle, set = {}, faults = [], signals = {} }) {
  const counted = [
    [Object.keys(set).length, "setting"],
    [faults.length, "fault"],
    [Object.keys(signals).length, "signal"],
  ];
  return [
    ...(obstacle ? ["obstacle"] : []),
    ...counted.filter(([count]) => count).map(([count, noun]) => numberOf(count, noun)),
  ];
}

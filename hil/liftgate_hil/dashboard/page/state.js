"use strict";
// The state of a run or of a recording, as the server sends it, in the page's elements.

const PHASES = {
  compiling: "compiling",
  ready: "ready: before the scenario",
  running: "running",
  late: "late",
  ended: "ended",
  recorded: "recording",
  idle: "no run",
  lost: "no connection",
  silent: "no data: the page's server stands still",
};
let last = null; // state that is shown
let hasEnded = false;
let moved = { time_s: null, at: 0 }; // model time that is shown, and since when

// Shows the phase, at its end with how the run has ended.
function showPhase(phase, ending = "") {
  const name = (phase === "late" && isStalled() ? "stalled" : PHASES[phase]) || phase;
  const words = ending ? `${name}: ${ending}` : name;
  if (find("phase").textContent !== words) find("phase").textContent = words;
  find("phase").className = `badge ${ending || phase}`;
}

// Whether a late run makes no ticks at all.
function isStalled() {
  return performance.now() > moved.at + 1000;
}

// Whether the ECU of a run sends no commands now, or sent none when it ended.
function isSilent(state) {
  const age = (state.bus || {}).command_age_s;
  return ["running", "late", "ended"].includes(state.phase) && (age === null || age > 0.5);
}

function showHealth(state) {
  const loop = state.loop || {},
    bus = state.bus || {},
    counted = (name) => (loop[name] || 0) - (about.before?.[name] || 0), // of a recording: those within it
    notes = [];
  if (state.phase === "late" && isStalled())
    notes.push(
      "Run not advancing (it waits for the ECU, or is paused). Commands take effect when it goes on.",
    );
  if (counted("ticks_missed")) notes.push(`${numberOf(counted("ticks_missed"), "tick")} missed`);
  if (counted("frames_dropped"))
    notes.push(`${numberOf(counted("frames_dropped"), "received frame")} lost or ignored: bench too slow`);
  if (bus.rejected) notes.push(`${numberOf(bus.rejected, "frame")} rejected`);
  if (bus.overwritten)
    notes.push(`${bus.overwritten} rows or frames were overwritten before this page saw them`);
  if (loop.stimuli_not_made) notes.push("the bench has not made all that it was asked for");
  if (bus.unsent) notes.push(`${numberOf(bus.unsent, "frame")} not sent`);
  if (isSilent(state))
    notes.unshift(
      "no command of the ECU" + (bus.command_age_s === null ? "" : ` for ${bus.command_age_s.toFixed(1)} s`),
    );
  const force = state.in_force || {},
    faults = (force.faults || []).length;
  if (!state.end && faults) notes.unshift(`${numberOf(faults, "injected fault")}`);
  if (!state.end && force.record) notes.unshift("recording");
  const words = notes.join(", ");
  if (find("health").textContent !== words) find("health").textContent = words;
}

// Buttons that put a column into the charts, made once each.
const choosers = new Map();
function chooser(name) {
  if (!choosers.has(name)) {
    const one = (column, word) => {
      const button = element(
        "button",
        { type: "button", onclick: () => choose(column), title: about.meanings[column] || column },
        word,
      );
      button.setAttribute("aria-label", `${word} ${name}`);
      return button;
    };
    const both = ["", "sensed_"]
      .map((prefix) => prefix + name)
      .filter((column) => about.columns.includes(column));
    choosers.set(
      name,
      element(
        "span",
        {},
        ...both.map((column) => one(column, column.startsWith("sensed_") ? "chart sensed" : "chart true")),
      ),
    );
  }
  return choosers.get(name);
}

async function choose(column) {
  charts.more = charts.more.includes(column)
    ? charts.more.filter((each) => each !== column)
    : [...charts.more, column].slice(-4);
  await load();
  charts.make();
  charts.draw();
}

function showValues(state) {
  const names = [...new Set([...Object.keys(state.truth), ...Object.keys(state.sensed)])];
  rows(
    find("columns"),
    names.map((name) => [
      name,
      chooser(name),
      state.truth[name],
      state.sensed[name],
      about.units[name] ?? about.units["sensed_" + name],
    ]),
  );
}

// Alarms are lines of the log: those of before the page was opened are not shown.
let alarmed = 0; // number of the last one that was shown
const openedAt = Date.now() / 1000;
function showAlarms(lines) {
  const fresh = lines.filter(([number, when]) => number > alarmed && when > openedAt);
  if (!fresh.length) return;
  alarmed = fresh.at(-1)[0];
  answer(fresh.at(-1)[2], true);
}

function showLog(lines) {
  if (!lines.length) return; // the lists' scroll positions are not asked for: that would lay out the page each time
  for (const [id, own, shorten] of [
    ["log", lines, (line) => line],
    ["events", lines.filter(([, , line]) => line.startsWith("ecu ")), (line) => line.slice(4)],
  ]) {
    const list = find(id),
      atEnd = list.scrollTop + list.clientHeight >= list.scrollHeight - 4;
    for (const [number, when, line] of own) {
      if (list.lastElementChild && number <= +list.lastElementChild.dataset.number) continue;
      const entry = element(
        "li",
        {},
        id === "log" ? `${new Date(when * 1000).toLocaleTimeString()}  ${line}` : shorten(line),
      );
      entry.dataset.number = number;
      list.append(entry);
    }
    while (list.children.length > MOST_LINES) list.firstElementChild.remove();
    if (atEnd) list.scrollTop = list.scrollHeight;
  }
}

function showCommand(command, isOld) {
  const isThere = (name) =>
    !name.startsWith("right_") || !about.geometry.drives || "right" in about.geometry.drives;
  const words = Object.entries(command || {})
    .filter(([name]) => isThere(name))
    .map(([name, { value, unit }]) => [
      name.replaceAll("_", " "),
      `${text(value, 1)}${unit && typeof value === "number" ? ` ${unit}` : ""}`,
    ]);
  const entries =
    !words.length && about.kind === "run"
      ? [["ECU", "no command yet"]]
      : isOld
        ? [["timed out,", "last command:"], ...words]
        : words;
  const list = find("command");
  list.classList.toggle("old", isOld);
  while (list.children.length > entries.length) list.lastElementChild.remove();
  entries.forEach(([name, value], k) => {
    const entry = list.children[k] || list.appendChild(element("div", {}, element("dt"), element("dd")));
    if (entry.firstChild.textContent !== name) entry.firstChild.textContent = name;
    if (entry.lastChild.textContent !== value) entry.lastChild.textContent = value;
  });
}

// What a recording knows of the command: the share of the voltage on each motor.
function recordedCommand(truth) {
  const found = {};
  for (const side of ["left", "right"]) {
    const duty = truth[`${side}_duty`];
    if (typeof duty === "number") found[`${side}_duty`] = { value: 100 * duty, unit: "%" };
    if (truth[`${side}_coast`] === 1) found[`${side}_direction`] = { value: "coast", unit: "" };
  }
  return found;
}

// Whether the gate is drawn, and if not, why.
function showWhetherDrawn(isDrawn) {
  const { columns, ours = {} } = about,
    names = ["gate_angle_deg", ours.gate_angle_deg, ours.sensed_gate_angle_deg],
    isMissing = about.kind === "recording" && !columns.some((each) => names.includes(each));
  find("scene-help").hidden = !isDrawn;
  find("not-drawn").hidden = isDrawn;
  find("not-drawn").textContent = isMissing
    ? "The gate is not drawn: the recording holds no gate_angle_deg, and no signal that the rig maps to it."
    : "The gate is not drawn: its angle is not known at this time.";
}

// Whether the last contact was before the recording, at a time in it.
function isPeakOfBefore({ time_s: time, truth }) {
  const { kind, contacts } = about;
  return (
    kind === "recording" && contacts && truth.pinch_force_peak_n > 0 && !contacts.some((it) => it.begin_s <= time)
  );
}

// The value of a column in a state.
function columnIn(state, name) {
  const own = name.replace(/^sensed_/, "");
  return own === name ? (state.truth[name] ?? (state.loop || {})[name]) : state.sensed[own];
}

function show(state) {
  last = state;
  if (state.time_s !== moved.time_s) moved = { time_s: state.time_s, at: performance.now() };
  const theirs = about.ours || {},
    fixed = (value, digits) => (typeof value === "number" ? value.toFixed(digits) : "–");
  const one = (name) =>
    state.truth[name] ?? state.truth[theirs[name]] ?? state.truth[theirs["sensed_" + name]];
  if (state.end) {
    if (!hasEnded) {
      showEnd(state.end, state.time_s);
      if (about.starts) listScenarios();
    }
  } else showPhase(state.phase);
  find("time").textContent = fixed(state.time_s, 2);
  find("angle").textContent = fixed(one("gate_angle_deg"), 2);
  find("pinch").textContent = fixed(one("pinch_force_n"), 1);
  find("peak").textContent = fixed(state.truth.pinch_force_peak_n, 0);
  find("peak").classList.toggle("over", isOver(state.truth.pinch_force_peak_n));
  showHealth(state);
  showCommand(about.kind === "recording" ? recordedCommand(state.truth) : state.command, isSilent(state));
  const since = isPeakOfBefore(state) ? ", before the recording" : "";
  if (find("peak-when").textContent !== since) find("peak-when").textContent = since;
  showGauge(one("pinch_force_n"), state.truth.pinch_force_peak_n, since);
  if (drawing) {
    const seen = [
      "gate_angle_deg",
      "road_slope_deg",
      "left_force_n",
      "right_force_n",
      "pinch_force_n",
      "hand_force_n",
      "latched",
      "latch_position",
    ];
    const isDrawn = drawing.show(
      Object.fromEntries(seen.map((name) => [name, one(name)])),
      (state.in_force || {}).obstacle,
      state.acting || {},
    );
    showWhetherDrawn(isDrawn);
  }
  if (controls)
    controls.show(state.truth, state.end ? { ...state.in_force, record: null } : state.in_force || {});
  if (find("values").open) showValues(state);
  if (find("bus-view").open) {
    showBus(state);
    if (state.messages) showMessages(state.messages, state.time_s);
  }
  charts.showValues();
  if (state.log) showLog(state.log);
  showAlarms(state.alarms || []);
  if (!state.end) showVerdicts(state.verdicts);
  if (state.histograms && state.histograms.lateness_us) {
    find("histograms").hidden = !state.histograms.lateness_us.length;
    drawHistogram(find("lateness"), state.histograms.lateness_us);
    drawHistogram(find("execution"), state.histograms.execution_us);
  }
  if (about.starts && state.started !== undefined) find("stop-run").disabled = state.started === null;
}

"use strict";
// The page of a run or of a recording: shows what the server sends, and posts what is commanded.

const token = new URLSearchParams(location.search).get("token") || "";
const find = (id) => document.getElementById(id);
const path = (name) => `${name}${name.includes("?") ? "&" : "?"}token=${encodeURIComponent(token)}`;
const HISTORY_S = 300; // of a run that is kept here
const PROBE_MS = 2000; // between two looks for a server that has gone
const POINTS = 2000;
const SCALE = "Gate, drives and obstacle are to scale, the car is an outline. A drive's force is that of its spindle, positive opens; the springs' forces are those of the vehicle file, less what a fault takes away.";
const PHASES = {
  compiling: "compiling", ready: "ready: before the scenario", running: "running", late: "late", ended: "ended", recorded: "recording", idle: "no run", lost: "no connection",
};
let about, charts, drawing = null, controls = null, isHeld = false, wire = null, last = null, hasEnded = false, isGone = false, moved = { time_s: null, at: 0 };

function text(value, digits = 4) {
  if (value === null || value === undefined) return "–";
  if (typeof value !== "number") return String(value);
  if (Number.isInteger(value)) return String(value);
  return Math.abs(value) >= 1e6 || (value !== 0 && Math.abs(value) < 1e-4) ? value.toExponential(3) : String(+value.toFixed(digits));
}

function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key in made) made[key] = value; else made.setAttribute(key, value);
  }
  made.append(...children);
  return made;
}

// What is so now.

function showPhase(phase, verdict = "") {
  const name = (phase === "late" && isStalled() ? "stalled" : PHASES[phase]) || phase;
  const words = verdict ? `${name}: ${verdict}` : name;
  if (find("phase").textContent !== words) find("phase").textContent = words;
  find("phase").className = `badge ${verdict || phase}`;
}

// Whether a late run makes no ticks at all.
function isStalled() { return performance.now() > moved.at + 1000; }

// Whether the ECU of a run sends no commands now.
function isSilent(told) {
  const age = (told.bus || {}).command_age_s;
  return ["running", "late"].includes(told.phase) && (age === null || age > 0.5);
}

function showHealth(told) {
  const loop = told.loop || {}, bus = told.bus || {}, said = [];
  if (told.phase === "late" && isStalled()) said.push("the run stands still, for example as it waits for the ECU: commands take effect when it continues");
  if (loop.ticks_missed) said.push(`${loop.ticks_missed} ticks missed`);
  if (loop.frames_dropped) said.push(`${loop.frames_dropped} received frame${loop.frames_dropped > 1 ? "s" : ""} not read in time`);
  if (bus.rejected) said.push(`${bus.rejected} frames rejected`);
  if (bus.overwritten) said.push(`${bus.overwritten} rows or frames were overwritten before this page saw them`);
  if (loop.stimuli_not_made) said.push("the bench has not made all that it was asked for");
  if (bus.unsent) said.push(`${bus.unsent} frames not sent`);
  if (isSilent(told)) said.push("no command of the ECU" + (bus.command_age_s === null ? "" : ` for ${bus.command_age_s.toFixed(1)} s`));
  const words = said.join(", ");
  if (find("health").textContent !== words) find("health").textContent = words;
}

function rows(table, made) {
  const body = table.tBodies[0];
  while (body.rows.length > made.length) body.deleteRow(-1);
  made.forEach((cells, r) => {
    const row = body.rows[r] || body.insertRow();
    cells.forEach((value, c) => {
      const cell = row.cells[c] || row.insertCell();
      if (value instanceof Node) { if (cell.firstChild !== value) cell.replaceChildren(value); return; }
      const said = text(value);
      if (cell.textContent !== said) cell.textContent = said;
      if (c > 0) cell.className = "mono";
    });
  });
}

// Buttons that put a column into the charts, made once each.
const choosers = new Map();
function chooser(name) {
  if (!choosers.has(name)) {
    const one = (column, word) => element("button", { type: "button", onclick: () => choose(column), title: `draw ${column}` }, word);
    const both = ["", "sensed_"].map((prefix) => prefix + name).filter((column) => about.columns.includes(column));
    choosers.set(name, element("span", {}, ...both.map((column) => one(column, column.startsWith("sensed_") ? "draw sensed" : "draw"))));
    choosers.get(name).querySelectorAll("button").forEach((button) => button.setAttribute("aria-label", button.title));
  }
  return choosers.get(name);
}

async function choose(column) {
  charts.more = charts.more.includes(column) ? charts.more.filter((each) => each !== column) : [...charts.more, column].slice(-4);
  await load();
  charts.make();
  charts.draw();
}

function showValues(told) {
  const names = [...new Set([...Object.keys(told.truth), ...Object.keys(told.sensed)])];
  rows(find("columns"), names.map((name) => [name, chooser(name), told.truth[name], told.sensed[name], about.units[name] ?? about.units["sensed_" + name]]));
}

function showBus(told) {
  const bus = told.bus || {}, loop = told.loop || {}, late = loop.lateness_us, spread = (of) => of && [of.p50_us, of.p99_us, of.max_us].map((each) => text(each, 1)).join(", ");
  const figures = [["channel", bus.channel], ["bus load [%]", bus.load_percent], ["frames sent", bus.sent], ["frames received", bus.received],
    ["commands accepted", bus.accepted], ["rejected", bus.rejected], ["foreign", bus.foreign], ["not sent", bus.unsent], ["dropped by the system", bus.dropped],
    ["clock", loop.clock], ["rate [Hz]", loop.rate_hz], ["ticks missed", loop.ticks_missed],
    ["lateness p50, p99, max [µs]", spread(late)], ["command to feedback p50, p99, max [µs]", spread(loop.command_delay_us)]];
  rows(find("bus"), figures.filter(([, value]) => value !== undefined && value !== null));
}

function showMessages(messages, now) {
  const ages = messages.map((each) => now - each.time_s);
  rows(find("messages"), messages.map((each, k) => [each.id, each.name, each.direction, each.count, each.cycle_ms === null ? "" : `${text(each.cycle_ms, 1)} ms`,
    ages[k] < 1 ? "" : `${ages[k].toFixed(0)} s ago`, each.data,
    Object.entries(each.signals).map(([name, value]) => `${name} = ${text(value, 3)}`).join(",  ")]));
  [...find("messages").tBodies[0].rows].forEach((row, k) => {
    row.className = ages[k] > Math.max(0.5, 3e-3 * (messages[k].cycle_ms || 0)) ? "stale" : "";
  });
}

function showLog(lines) {
  for (const [id, own, shorten] of [["log", lines, (said) => said], ["events", lines.filter(([, , said]) => said.startsWith("ecu ")), (said) => said.slice(4)]]) {
    const list = find(id), atEnd = list.scrollTop + list.clientHeight >= list.scrollHeight - 4;
    for (const [number, when, said] of own) {
      if (list.lastElementChild && number <= +list.lastElementChild.dataset.number) continue;
      const line = element("li", {}, id === "log" ? `${new Date(when * 1000).toLocaleTimeString()}  ${said}` : shorten(said));
      line.dataset.number = number;
      list.append(line);
    }
    while (list.children.length > 200) list.firstElementChild.remove();
    if (atEnd) list.scrollTop = list.scrollHeight;
  }
}

function showCommand(command, isOld) {
  const isThere = (name) => !name.startsWith("right_") || !about.geometry.drives || "right" in about.geometry.drives;
  const words = Object.entries(command || {}).filter(([name]) => isThere(name)).map(([name, { value, unit }]) => [name.replaceAll("_", " "), `${text(value, 1)}${unit && typeof value === "number" ? ` ${unit}` : ""}`]);
  const said = !words.length && about.kind === "run" ? [["ECU", "no command yet"]] : isOld ? [["timed out", "last command:"], ...words] : words;
  const list = find("command");
  list.classList.toggle("old", isOld);
  while (list.children.length > said.length) list.lastElementChild.remove();
  said.forEach(([name, value], k) => {
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
    if (truth[`${side}_coast`] === 1) found[`${side}_duty`] = { value: "coast", unit: "" };
  }
  return found;
}

function showGauge(now, peak, limit) {
  const full = Math.max(2 * (limit || 100), peak || 0, now || 0), x = (force) => 1 + 198 * within((force || 0) / full, 0, 1);
  find("gauge-now").setAttribute("width", x(now) - 1);
  find("gauge-now").classList.toggle("over", Boolean(limit) && now > limit);
  find("gauge-peak").setAttribute("d", peak > 0 ? `M${x(peak)} 2V16` : "");
  find("gauge-limit").setAttribute("d", limit ? `M${x(limit)} 1V20` : "");
  const words = `Pinch force ${text(now, 0)} N${limit ? `, limit ${text(limit, 0)} N` : ""}`;
  if (find("gauge-text").textContent !== words) find("gauge-text").textContent = words;
}

function showVerdicts(verdicts) {
  if (!verdicts || !verdicts.length) return;
  find("verdicts").hidden = false;
  const table = find("verdicts").querySelector("table");
  rows(table, verdicts.map((each) => [each.name, each.verdict, each.margin === null ? "" : `${text(each.margin, 3)} ${each.margin_unit}`, each.time_s === null ? "" : `${text(each.time_s, 3)} s`]));
  [...table.tBodies[0].rows].forEach((row, k) => { row.cells[1].className = verdicts[k].verdict; });
}

function showEnd(end) {
  hasEnded = true;
  find("commands").disabled = true;
  const isJudged = end.expectations.length > 0 || end.verdict !== "pass", code = end.exit_code === null ? "" : `exit code ${end.exit_code}`;
  showPhase("ended", isJudged ? end.verdict : "");
  find("end").hidden = false;
  find("end").className = isJudged ? end.verdict : "";
  find("end-verdict").textContent = isJudged ? `The run has ended: ${end.verdict}${code && ` (${code})`}` : `The run has ended${code && ` (${code})`}.${about.scenario ? " It had no expectations." : ""}`;
  const reasons = {}; // one that several expectations share is told once
  for (const each of end.expectations) if (each.reason) (reasons[each.reason] ??= []).push(each.name);
  find("end-reason").textContent = end.reason || Object.entries(reasons).map(([reason, names]) => `${names.join(", ")}: ${reason}`).join("; ");
  find("end-next").textContent = about.starts ? "Start a scenario to go on." : about.ends_with_run ? "This page has ended with its run. It comes back if a run begins with the same address and LIFTGATE_HIL_TOKEN." : "The next run on this bus is shown as soon as it begins.";
  showVerdicts(end.expectations);
}

function show(told) {
  last = told;
  if (told.time_s !== moved.time_s) moved = { time_s: told.time_s, at: performance.now() };
  const theirs = about.ours || {}, fixed = (value, digits) => typeof value === "number" ? value.toFixed(digits) : "–";
  const one = (name) => told.truth[name] ?? told.truth[theirs[name]] ?? told.truth[theirs["sensed_" + name]];
  if (told.end) { if (!hasEnded) showEnd(told.end); } else showPhase(told.phase);
  find("time").textContent = fixed(told.time_s, 2);
  find("angle").textContent = fixed(one("gate_angle_deg"), 2);
  find("pinch").textContent = fixed(one("pinch_force_n"), 1);
  find("peak").textContent = fixed(told.truth.pinch_force_peak_n, 0);
  find("peak").classList.toggle("over", told.truth.pinch_force_peak_n > about.geometry.pinch_limit_n);
  showHealth(told);
  showCommand(about.kind === "recording" ? recordedCommand(told.truth) : told.command, isSilent(told));
  showGauge(one("pinch_force_n"), told.truth.pinch_force_peak_n, about.geometry.pinch_limit_n);
  if (drawing) {
    const seen = ["gate_angle_deg", "road_slope_deg", "left_force_n", "right_force_n", "pinch_force_n", "hand_force_n", "latched", "latch_position"];
    drawing.show(Object.fromEntries(seen.map((name) => [name, one(name)])), (told.in_force || {}).obstacle, told.acting || {});
  }
  if (controls) controls.show(told.truth, told.end ? { ...told.in_force, record: null } : told.in_force || {});
  if (find("values").open) showValues(told);
  if (find("bus-view").open) { showBus(told); if (told.messages) showMessages(told.messages, told.time_s); }
  if (told.log) showLog(told.log);
  if (!told.end) showVerdicts(told.verdicts);
  if (told.histograms && told.histograms.lateness_us) {
    find("histograms").hidden = !told.histograms.lateness_us.length;
    drawHistogram(find("lateness"), told.histograms.lateness_us);
    drawHistogram(find("execution"), told.histograms.execution_us);
  }
  if (about.starts && told.started !== undefined) find("stop-run").disabled = told.started === null;
}

// Commands.

const ANSWER_MS = 8000; // that an answer is shown
let answered = null;
function answer(words, isBad) {
  find("answer").className = isBad ? "bad" : "";
  find("answer").textContent = words;
  clearTimeout(answered);
  if (!isBad) answered = setTimeout(() => { find("answer").textContent = ""; }, ANSWER_MS);
}

async function post(where, content) {
  if (isGone) { answer("no connection to the server", true); return null; }
  try {
    const response = await fetch(path(where), { method: "POST", body: JSON.stringify(content), headers: { "Content-Type": "application/json" }, keepalive: true });
    const said = await response.json();
    if (!response.ok) { answer(said.issues.map((each) => each.replaceAll("`", "")).join("\n"), true); return null; }
    return said;
  } catch {
    answer("no connection to the server", true);
    return null;
  }
}

async function command(content) {
  const said = await post("/api/command", content);
  if (said) answer(said.waits || `${text(said.time_s, 3)} s: ${said.done}`, false);
  return said;
}

// The time axis of the charts.

function follow() {
  const end = charts.times.length ? charts.times[charts.times.length - 1] : 1, width = +find("window").value;
  charts.zoom(Math.max(0, end - width), Math.max(end, width));
}

// Of a run: the charts stand still, or go on.
function hold(on) {
  isHeld = on;
  find("hold").textContent = on ? "Go on" : "Pause charts";
  if (!on && about.kind === "run") follow();
}

async function load(low = -Infinity, high = Infinity) {
  const asked = [`columns=${charts.drawn.join(",")}`, `points=${POINTS}`, ...(Number.isFinite(low) ? [`from=${low}`, `to=${high}`] : [])];
  charts.take(await (await fetch(path(`/api/plot?${asked.join("&")}`))).json());
}

let loading = null;
function zoomTo(low, high) {
  if (about.kind === "recording") {
    const least = (about.end_s - about.begin_s) * 1e-5, wide = within(high - low, least, about.end_s - about.begin_s);
    low = within(low, about.begin_s, about.end_s - wide); high = low + wide;
    clearTimeout(loading);
    loading = setTimeout(async () => { await load(low, high); charts.draw(); }, 120);
  } else hold(true);
  charts.zoom(low, high);
}

function makeView() {
  const about_ = (factor, shift = 0) => { const [low, high] = charts.range, half = (high - low) / 2, middle = (low + high) / 2 + shift * half; zoomTo(middle - factor * half, middle + factor * half); };
  find("zoom-in").onclick = () => about_(0.5);
  find("zoom-out").onclick = () => about_(2);
  find("earlier").onclick = () => about_(1, -0.5);
  find("later").onclick = () => about_(1, 0.5);
  find("whole").onclick = () => {
    if (about.kind === "recording") zoomTo(about.begin_s, about.end_s);
    else if (charts.times.length) { hold(true); charts.zoom(charts.times[0], charts.times[charts.times.length - 1]); }
  };
  find("hold").onclick = () => hold(!isHeld);
  find("window").onchange = () => { hold(false); follow(); };
}

// The wire.

function connect() {
  wire = new WebSocket(path(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/stream`));
  wire.onmessage = (event) => {
    const told = JSON.parse(event.data);
    if (told.number !== undefined && told.number !== about.number) { location.reload(); return; } // the next run
    if (about.kind === "recording") {
      point(told.time_s);
      if (told.is_over) stop();
    } else if (told.span && told.span.low) {
      charts.append(told.time_s, told.span, HISTORY_S);
      if (!isHeld) follow();
    }
    show(told);
  };
  wire.onclose = () => { wire = null; if (about.kind !== "recording") gone(); };
}

// The server is gone. A frame, unlike a request, fails without an entry in the browser's console.
function gone() {
  isGone = true;
  find("commands").disabled = true;
  if (!hasEnded) showPhase("lost");
  const frame = element("iframe", { hidden: true, title: "connection" });
  frame.onload = () => {
    let answered = "";
    try { answered = frame.contentDocument.body.textContent; } catch { /* nobody answers yet */ }
    frame.remove();
    if (answered.includes('"number"')) { location.reload(); return; }
    if (answered.includes('"issues"')) { find("end-next").textContent = "Another server answers here now: open the address that it printed."; return; }
    setTimeout(gone, PROBE_MS);
  };
  frame.src = path("/api/about");
  document.body.append(frame);
}

// A recording.

function point(time) {
  find("seek").value = time;
  charts.now = time;
  for (const { plot } of charts.charts) plot.redraw(false);
  charts.showValues();
}

async function seek(time) {
  if (wire && wire.readyState === 1) { wire.send(JSON.stringify({ time_s: time })); return; }
  point(time);
  show(await (await fetch(path(`/api/state?time=${time}`))).json());
}

function stop() {
  find("play").textContent = "Play";
  if (wire) { wire.onclose = null; wire.close(); wire = null; }
}

function makeReplay() {
  const bar = find("seek"), play = find("play");
  find("replay").hidden = false;
  bar.min = about.begin_s; bar.max = about.end_s; bar.value = about.end_s;
  bar.addEventListener("input", () => seek(+bar.value));
  const speed = () => ({ speed: +find("speed").value });
  find("speed").onchange = () => { if (wire && wire.readyState === 1) wire.send(JSON.stringify(speed())); };
  play.onclick = () => {
    if (wire) { stop(); return; }
    const begin = +bar.value >= about.end_s - 1e-9 ? about.begin_s : +bar.value;
    connect();
    wire.addEventListener("open", () => wire.send(JSON.stringify({ time_s: begin, ...speed() })));
    play.textContent = "Pause";
  };
  const contacts = about.contacts.map((each) => element("button", { type: "button", onclick: () => {
    stop();
    const around = Math.max(0.3, each.end_s - each.begin_s);
    zoomTo(each.begin_s - around, each.end_s + around);
    seek(each.peak_s);
  } }, `pinch ${text(each.peak_n, 0)} N at ${text(each.peak_s, 2)} s`));
  const marks = about.marks.map((each) => element("button", { type: "button", onclick: () => { stop(); seek(each.time_s); } }, `${each.text} at ${text(each.time_s, 2)} s`));
  find("contacts").append(...(contacts.length ? ["Contacts:", ...contacts] : ["No contact with an obstacle."]), ...(marks.length ? ["Marks:", ...marks] : []));
}

// The start.

function makeStart() {
  find("starting").hidden = false;
  fetch(path("/api/run")).then((response) => response.json()).then(({ scenarios, running }) => {
    find("start-name").append(...scenarios.map((name) => element("option", {}, name)));
    const shown = running || scenarios.find((name) => about.scenario && about.scenario.endsWith(`/${name}`));
    if (shown) find("start-name").value = shown;
  });
  submit(find("start"), async () => { answer("starting …", false); if (await post("/api/run", { scenario: find("start-name").value })) answer("", false); });
  find("stop-run").onclick = () => post("/api/run", { scenario: null });
}

function makeTitle() {
  const name = (file) => file.split("/").pop().replace(/\.[^.]*$/, "");
  const titles = { run: () => [name(about.vehicle), about.scenario && name(about.scenario), about.starts ? "" : about.channel].filter(Boolean).join(" · "), recording: () => about.file.split("/").pop(), none: () => "liftgate-hil" };
  find("title").textContent = titles[about.kind]();
  document.title = `${find("title").textContent} – liftgate-hil`;
}

async function start() {
  const response = await fetch(path("/api/about"));
  about = await response.json();
  if (!response.ok) { find("phase").textContent = about.issues.join("; "); return; }
  about.geometry = await (await fetch(path("/api/geometry"))).json();
  const isRun = about.kind === "run", isOpen = isRun && !about.read_only;
  makeTitle();
  document.body.classList.add(about.kind);
  charts = new Charts(find("plots"), about, {
    zoomed: ([low, high]) => zoomTo(low, high),
    pointed: (time) => { find("cursor").textContent = time === null ? "" : `cursor at ${time.toFixed(3)} s`; },
    seek: about.kind === "recording" ? seek : null,
  });
  await load();
  if (isOpen) controls = new Controls(about.commands, command, about.geometry.open_angle_deg); else find("commands").hidden = true;
  const act = isOpen ? { hand: (newtons) => command({ set: { hand_force_n: newtons } }), put: (changed) => controls.put(changed), remove: () => command({ clear: "obstacle" }) } : null;
  if (about.geometry.length_m) drawing = new Drawing(find("drawing"), about.geometry, act);
  find("scene").hidden = !drawing;
  find("scene-help").textContent = act ? `Drag the green hand to push or pull the gate, and the obstacle into its way; or focus one of them and use the arrow keys. ${SCALE}` : SCALE;
  find("stimuli").append(...(about.stimuli || []).map((each) => element("li", {}, each)));
  find("scenario").hidden = !(about.stimuli || []).length;
  find("readonly").hidden = !(isRun && about.read_only);
  find("hold").hidden = find("window").hidden = !isRun;
  find("controls").hidden = about.kind === "recording";
  find("reports").hidden = !isRun; find("charts").hidden = about.kind === "none";
  find("bus-view").hidden = !isRun; find("values").hidden = about.kind === "none";
  for (const id of ["values", "bus-view"]) find(id).addEventListener("toggle", () => { if (last) show(last); });
  makeView();
  if (about.starts && !about.read_only) makeStart();
  find("start-help").hidden = isRun;
  if (about.kind === "recording") {
    makeReplay();
    charts.zoom(about.begin_s, about.end_s);
    const peak = about.contacts.reduce((most, each) => (most && most.peak_n > each.peak_n ? most : each), null);
    await seek(peak ? peak.peak_s : about.begin_s);
  } else {
    show(await (await fetch(path("/api/state"))).json());
    hold(false);
    connect();
  }
  document.body.dataset.ready = "yes";
}
start();

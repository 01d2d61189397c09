"use strict";
// The page of a run or of a recording: draws what the server tells, and posts what is commanded.
const token = new URLSearchParams(location.search).get("token") || "";
const find = (id) => document.getElementById(id);
const path = (name) => `${name}${name.includes("?") ? "&" : "?"}token=${encodeURIComponent(token)}`;
const HISTORY_S = 300; // of a run that is kept here
const COLORS = ["#1f77c9", "#d1495b", "#2a9d6f", "#e08e1a"];
const PANELS = [ // title, columns, the least that the axis shows
  ["angle [deg]", ["gate_angle_deg"], 5],
  ["motor current [A]", ["left_current_a", "right_current_a"], 2],
  ["pinch force [N]", ["pinch_force_n"], 10],
  ["terminal voltage [V]", ["terminal_voltage_v"], 1],
];
let about, panels = [], times = [], low = {}, high = {}, isHeld = false, chosen = [];

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

// Plots: of each column what was lowest and highest in each stretch, so that no peak is lost.

function panelColumns() {
  const theirs = about.ours || {}, known = new Set(about.columns);
  const here = (name) => theirs[name] || name;
  let found = PANELS.map(([title, names, least]) => [title, names.flatMap((name) => [name, "sensed_" + name]).map(here).filter((name) => known.has(name)), least])
    .map(([title, names, least]) => [title, [...new Set(names)], least]).filter(([, names]) => names.length);
  if (!found.length) found = about.columns.slice(1, 5).map((name) => [`${name} [${about.units[name]}]`, [name], 0]);
  if (chosen.length) found.push(["chosen", chosen, 0]);
  return found;
}

// From the lowest to the highest, but for as much as `least` at least.
function rangeOf(least) {
  return (plot, low_, high_) => {
    if (low_ === null) return [0, least || 1];
    const middle = (low_ + high_) / 2, half = Math.max(high_ - low_, least || 1e-9) / 2 * 1.05;
    return [middle - half, middle + half];
  };
}

function makePlots() {
  const style = getComputedStyle(document.documentElement);
  const dim = style.getPropertyValue("--dim").trim(), line = style.getPropertyValue("--line").trim();
  const axis = { stroke: dim, grid: { stroke: line, width: 1 }, ticks: { stroke: line } };
  for (const { plot } of panels) plot.destroy();
  find("plots").replaceChildren();
  panels = [];
  for (const [title, names, least] of panelColumns()) {
    const box = element("div");
    find("plots").append(box);
    const series = [{ label: "time [s]" }], bands = [];
    const hasTruth = names.some((name) => !name.startsWith("sensed_"));
    names.forEach((name, k) => {
      const color = COLORS[k % COLORS.length], shown = !hasTruth || title === "chosen" || !name.startsWith("sensed_");
      const dash = name.startsWith("right_") ? [6, 4] : undefined;
      series.push({ label: name, stroke: color, width: 1, dash, show: shown, points: { show: false } });
      series.push({ label: `${name} lowest`, stroke: color, width: 1, dash, show: shown, points: { show: false } });
      bands.push({ series: [2 * k + 1, 2 * k + 2], fill: color + "40" });
    });
    const plot = new uPlot({
      title, width: box.clientWidth - 20, height: 170, series, bands,
      scales: { x: { time: false }, y: { range: rangeOf(least) } }, axes: [axis, { ...axis, size: 60 }],
      cursor: { sync: { key: "time" } }, legend: { live: true },
      hooks: { setSeries: [(drawn, k) => together(drawn, k)], setSelect: [() => hold(about.kind === "run")] },
    }, [[]], box);
    box.querySelectorAll(".u-legend tr").forEach((row, k) => { if (k > 1 && k % 2 === 0) row.classList.add("unseen"); });
    if (about.kind === "recording") {
      plot.over.addEventListener("click", () => { if (plot.cursor.left >= 0) seek(plot.posToVal(plot.cursor.left, "x")); });
    }
    panels.push({ plot, names, box });
  }
}

function resize() {
  for (const each of panels) each.plot.setSize({ width: each.box.clientWidth - 20, height: 170 });
}

// Of a run: the plots stand still, or go on.
function hold(on) {
  isHeld = on;
  find("hold").textContent = on ? "Go on" : "Pause";
}

// A column is drawn, or not any more.
function choose(name) {
  chosen = chosen.includes(name) ? chosen.filter((each) => each !== name) : [...chosen, name].slice(-4);
  makePlots();
  draw();
}

// The two lines of a column's band are shown or hidden as one.
function together(plot, k) {
  if (!k) return;
  const other = k % 2 ? k + 1 : k - 1, shown = plot.series[k].show;
  if (plot.series[other].show !== shown) plot.setSeries(other, { show: shown });
}

function draw() {
  const end = times.length ? times[times.length - 1] : 0;
  for (const { plot, names } of panels) {
    const data = [times];
    for (const name of names) data.push(high[name], low[name]);
    plot.setData(data, false);
    if (!times.length) continue;
    const first = about.kind === "run" ? Math.max(times[0], end - +find("window").value) : times[0];
    plot.setScale("x", { min: first, max: end });
  }
}

function takePlot(plot) {
  times = plot.time_s;
  for (const name of about.columns) { low[name] = plot.low[name] || []; high[name] = plot.high[name] || []; }
}

function append(told) {
  const time = told.truth.time_s;
  if (times.length && time < times[times.length - 1]) return;
  times.push(time);
  about.columns.forEach((name, k) => { low[name].push(told.span.low[k]); high[name].push(told.span.high[k]); });
  const first = times.findIndex((each) => each >= time - HISTORY_S);
  if (first > 600) {
    times.splice(0, first);
    for (const name of about.columns) { low[name].splice(0, first); high[name].splice(0, first); }
  }
}

// What is so now.

function badge(state) { find("state").textContent = state; find("state").className = `badge ${state}`; }

function health(told) {
  const loop = told.loop || {}, bus = told.bus || {}, said = [];
  if (loop.ticks_missed) said.push(`${loop.ticks_missed} ticks missed`);
  if (loop.frames_dropped) said.push(`${loop.frames_dropped} frames dropped`);
  if (bus.rejected) said.push(`${bus.rejected} frames rejected`);
  if (bus.overwritten) said.push(`${bus.overwritten} rows or frames came and went before this page saw them`);
  if (loop.stimuli_not_made) said.push("the bench has not made all that it was asked for");
  if (bus.unsent) said.push(`${bus.unsent} frames not sent`);
  if (told.state === "running" && bus.command_age_s === null) said.push("no command");
  find("health").textContent = said.join(", ");
}

function rows(id, made) {
  const body = find(id).tBodies[0];
  while (body.rows.length > made.length) body.deleteRow(-1);
  made.forEach((cells, r) => {
    const row = body.rows[r] || body.insertRow();
    cells.forEach((value, c) => {
      const cell = row.cells[c] || row.insertCell();
      const said = text(value);
      if (cell.textContent !== said) cell.textContent = said;
      if (c > 0) cell.className = "mono";
    });
  });
}

function showTables(told) {
  const names = [...new Set([...Object.keys(told.truth), ...Object.keys(told.sensed)])];
  rows("columns", names.map((name) => [name, told.truth[name], told.sensed[name], about.units[name] ?? about.units["sensed_" + name]]));
  for (const row of find("columns").tBodies[0].rows) row.className = chosen.some((each) => each === row.cells[0].textContent || each === "sensed_" + row.cells[0].textContent) ? "chosen" : "";
  const bus = told.bus || {}, loop = told.loop || {}, late = loop.lateness_us;
  const figures = [["channel", bus.channel], ["bus load [%]", bus.load_percent], ["frames sent", bus.sent], ["frames received", bus.received],
    ["commands accepted", bus.accepted], ["rejected", bus.rejected], ["foreign", bus.foreign], ["not sent", bus.unsent], ["dropped", bus.dropped],
    ["clock", loop.clock], ["rate [Hz]", loop.rate_hz], ["ticks missed", loop.ticks_missed],
    ["lateness p50, p99, max [µs]", late && [late.p50_us, late.p99_us, late.max_us].map((each) => text(each, 1)).join(", ")]];
  rows("bus", figures.filter(([, value]) => value !== undefined && value !== null));
}

function showMessages(messages, now) {
  const ages = messages.map((each) => now - each.time_s);
  rows("messages", messages.map((each, k) => [each.id, each.name, each.direction, each.count, each.cycle_ms === null ? "" : `${text(each.cycle_ms, 1)} ms`,
    ages[k] < 1 ? "" : `${ages[k].toFixed(0)} s ago`, each.data,
    Object.entries(each.signals).map(([name, value]) => `${name} = ${text(value, 3)}`).join(",  ")]));
  [...find("messages").tBodies[0].rows].forEach((row, k) => {
    row.className = ages[k] > Math.max(0.5, 3e-3 * (messages[k].cycle_ms || 0)) ? "stale" : "";
  });
}

function showLog(lines) {
  const list = find("log"), atEnd = list.scrollTop + list.clientHeight >= list.scrollHeight - 4;
  for (const [number, when, said] of lines) {
    if (list.lastElementChild && number <= +list.lastElementChild.dataset.number) continue;
    const line = element("li", {}, `${new Date(when * 1000).toLocaleTimeString()}  ${said}`);
    line.dataset.number = number;
    list.append(line);
  }
  while (list.children.length > 200) list.firstElementChild.remove();
  if (atEnd) list.scrollTop = list.scrollHeight;
}

let shownForce = "";
function showInForce(force) {
  const said = JSON.stringify(force);
  if (said === shownForce || find("commands").hidden) return;
  shownForce = said;
  chips("set-on", Object.entries(force.set || {}).map(([name, value]) => [`${name} ${text(value)}`, { clear: { set: name } }]));
  const inWords = (each) => Object.entries(each).map(([name, value]) => ["kind", "where"].includes(name) ? value : `${name} ${text(value)}`).join(" ");
  chips("fault-on", (force.faults || []).map((each) => [inWords(each), { clear: { fault: each } }]));
  chips("obstacle-on", force.obstacle ? [[inWords(force.obstacle), { clear: "obstacle" }]] : []);
  chips("signal-on", Object.entries(force.signals || {}).map(([name, value]) => [`${name} = ${text(value)}`, { clear: { signal: name } }]));
}

function chips(id, each) {
  find(id).replaceChildren(...each.map(([said, command]) => {
    const chip = element("li", {}, said);
    if (command) chip.append(element("button", { type: "button", title: `clear ${said}`, onclick: () => command_(command) }, "×"));
    return chip;
  }));
}

function show(told) {
  badge(told.state);
  const theirs = about.ours || {}, fixed = (value, digits) => typeof value === "number" ? value.toFixed(digits) : "–";
  const one = (name) => told.truth[name] ?? told.truth[theirs[name]] ?? told.truth[theirs["sensed_" + name]];
  find("time").textContent = fixed(told.time_s, 2);
  find("angle").textContent = fixed(one("gate_angle_deg"), 2);
  find("pinch").textContent = fixed(one("pinch_force_n"), 1);
  find("peak").textContent = fixed(told.truth.pinch_force_peak_n, 0);
  health(told);
  showTables(told);
  showInForce(told.in_force || {});
  if (told.log) showLog(told.log);
  if (told.messages) showMessages(told.messages, told.time_s);
}

// Commands.

async function command_(command) {
  const answer = find("answer");
  try {
    const response = await fetch(path("/api/command"), { method: "POST", body: JSON.stringify(command), headers: { "Content-Type": "application/json" } });
    const said = await response.json();
    answer.className = response.ok ? "" : "bad";
    answer.textContent = response.ok ? said.waits || `${text(said.time_s, 3)} s: ${said.done}` : said.issues.map((each) => each.replaceAll("`", "")).join("\n");
  } catch (error) {
    answer.className = "bad";
    answer.textContent = `no answer: ${error.message}`;
  }
}

// An input for a value: labels to choose from, else a number with its range, else a text.
function input(key, spec) {
  const labels = spec.labels || [], range = spec.low === undefined ? spec.allowed || "" : `${text(spec.low)} to ${text(spec.high)} ${spec.unit || ""}`;
  let made;
  if (labels.length && spec.isSignal) { // which may have other values, too
    made = element("input", { type: "text", required: true });
    made.setAttribute("list", "signal-labels");
    find("signal-labels").replaceChildren(...labels.map((label) => element("option", { value: label })));
  } else if (labels.length) {
    made = element("select", {}, ...labels.map((label, k) => element("option", { value: spec.byPlace ? k : label }, label)));
  } else if (spec.low !== undefined) {
    made = element("input", { type: "number", step: "any", min: spec.low, max: spec.high, required: spec.default === null || spec.default === undefined });
  } else {
    made = element("input", { type: "text", required: spec.default === null });
  }
  if (spec.default !== null && spec.default !== undefined && made.tagName === "INPUT") made.value = spec.default;
  made.name = key;
  made.title = `${spec.meaning || key}; allowed: ${labels.length ? labels.join(", ") : range}`;
  made.setAttribute("aria-label", key);
  made.placeholder = key;
  return made;
}

function valueOf(field, spec) {
  if (field.value === "") return undefined;
  if (spec.isSignal) return Number.isNaN(Number(field.value)) ? field.value : Number(field.value);
  return spec.low !== undefined && (spec.byPlace || !(spec.labels || []).length) ? Number(field.value) : field.value;
}

function makeCommands() {
  const can = about.commands, withLabels = (each) => ({ ...each, byPlace: each.labels.length > 0 });
  find("requests").append(...(can.request.length ? can.request.map((action) =>
    element("button", { type: "button", onclick: () => command_({ request: action }) }, action)) : ["The rig has no [requests]."]));

  const usual = { angle_deg: 35, stiffness: 10000 }, rod = find("obstacle"), rodFields = {};
  for (const [name, spec] of Object.entries(can.obstacle)) {
    rodFields[name] = input(name, { ...spec, default: usual[name] ?? "" });
    rod.append(element("label", {}, labelled(name, spec.unit), rodFields[name]));
  }
  rodFields.meets = input("meets", { labels: ["closing", "opening"], meaning: "which way the gate meets it" });
  rod.append(element("label", {}, "meets", rodFields.meets), element("div", { className: "row" }, element("button", {}, "Put")));
  submit("obstacle", () => {
    const said = {};
    for (const [name, field] of Object.entries(rodFields)) {
      const value = valueOf(field, can.obstacle[name] || { labels: ["closing"] });
      if (value !== undefined) said[name] = value;
    }
    return { obstacle: said };
  });

  chooser("set-name", "set-value", can.set, withLabels);
  submit("set", () => one("set-name", "set-value", can.set, "set", withLabels));

  find("signal-names").append(...Object.keys(can.signal).map((name) => element("option", { value: name })));
  const asLabels = (each) => ({ ...each, isSignal: true, default: each.start });
  chooser("signal-name", "signal-value", can.signal, asLabels);
  submit("signal", () => one("signal-name", "signal-value", can.signal, "signal", asLabels));

  const kinds = find("fault-kind"), keys = find("fault-keys");
  kinds.append(...Object.keys(can.fault).map((name) => element("option", {}, name)));
  const change = () => {
    const kind = can.fault[kinds.value], made = [];
    if (kind.where.length) {
      const all = kind.of === "a message" ? ["", ...kind.where] : kind.where;
      made.push(element("select", { name: "where", title: kind.of }, ...all.map((name) => element("option", { value: name }, name || "all"))));
    }
    const labels = Object.entries(kind.keys).map(([name, spec]) => element("label", {}, labelled(name, spec.unit), input(name, spec)));
    keys.replaceChildren(...made, ...labels);
    find("fault-meaning").textContent = kind.meaning;
  };
  kinds.onchange = change;
  change();
  submit("fault", () => {
    const said = { kind: kinds.value }, specs = can.fault[kinds.value].keys;
    for (const field of keys.querySelectorAll("input, select")) {
      const value = valueOf(field, specs[field.name] || { labels: ["x"] });
      if (value !== undefined) said[field.name] = value;
    }
    return { fault: said };
  });
  find("clear").onclick = () => command_({ clear: "all" });
}

function labelled(name, unit) {
  const plain = name.replace(/_(deg|s|n|v|a)$/, "");
  return unit ? `${plain} [${unit}]` : plain;
}

function submit(id, commandOf) {
  find(id).addEventListener("submit", (event) => { event.preventDefault(); const said = commandOf(); if (said) command_(said); });
}

// A name to choose, and an input for its value beside it.
function chooser(nameId, valueId, specs, shaped) {
  const names = find(nameId);
  if (names.tagName === "SELECT") names.append(...Object.keys(specs).map((name) => element("option", {}, name)));
  const change = () => {
    const spec = specs[names.value];
    find(valueId).replaceChildren(...(spec ? [input(names.value, shaped(spec)), ` ${spec.unit}`] : []));
    names.title = spec ? spec.meaning : "";
  };
  names.addEventListener(names.tagName === "SELECT" ? "change" : "input", change);
  change();
}

function one(nameId, valueId, specs, kind, shaped) {
  const name = find(nameId).value, field = find(valueId).querySelector("input,select");
  if (!field) return { [kind]: { [name]: null } }; // which the server refuses, and says what is allowed
  return { [kind]: { [name]: valueOf(field, shaped(specs[name])) } };
}

// The wire.

let wire = null;
function connect() {
  wire = new WebSocket(path(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/stream`));
  wire.onmessage = (event) => {
    const told = JSON.parse(event.data);
    if (about.kind === "run") {
      if (told.span && told.span.low) { append(told); if (!isHeld) draw(); }
    } else {
      find("seek").value = told.time_s;
      for (const { plot } of panels) plot.setCursor({ left: plot.valToPos(told.time_s, "x"), top: 10 }, false);
      if (told.is_over) { find("play").textContent = "Play"; wire.close(); wire = null; }
    }
    show(told);
  };
  wire.onclose = (event) => {
    if (about.kind !== "run") return;
    if (event.code === 1012) { badge("ended"); return; } // the server says that it ends, as with its run
    badge("lost");
    setTimeout(connect, 1000);
  };
}

async function seek(time) {
  if (wire && wire.readyState === 1) { wire.send(JSON.stringify({ time_s: time })); return; }
  find("seek").value = time;
  show(await (await fetch(path(`/api/state?time=${time}`))).json());
}

function makeReplay() {
  const bar = find("seek"), play = find("play");
  find("replay").hidden = false;
  bar.min = about.begin_s; bar.max = about.end_s; bar.value = about.end_s;
  bar.addEventListener("input", () => seek(+bar.value));
  play.onclick = () => {
    if (wire) { wire.onclose = null; wire.close(); wire = null; play.textContent = "Play"; return; }
    const begin = +bar.value >= about.end_s - 1e-9 ? about.begin_s : +bar.value;
    connect();
    wire.addEventListener("open", () => wire.send(JSON.stringify({ time_s: begin })));
    play.textContent = "Pause";
  };
}

async function start() {
  const answer = await fetch(path("/api/about"));
  about = await answer.json();
  if (!answer.ok) { badge(about.issues.join("; ")); return; }
  const isRun = about.kind === "run";
  const name = (file) => file.split("/").pop().replace(/\.[^.]*$/, "");
  find("title").textContent = isRun ? [name(about.vehicle), about.scenario && name(about.scenario), about.channel].filter(Boolean).join(" · ") : about.file;
  document.title = `${find("title").textContent} – liftgate-hil`;
  if (isRun) find("view").hidden = false;
  find("hold").onclick = () => { hold(!isHeld); draw(); };
  find("window").onchange = () => { hold(false); draw(); };
  find("columns").addEventListener("click", (event) => {
    const cell = event.target.closest("td");
    if (!cell || cell.cellIndex > 2) return;
    const name = cell.parentElement.cells[0].textContent, column = cell.cellIndex === 2 ? "sensed_" + name : name;
    if (about.columns.includes(column)) choose(column);
  });
  new ResizeObserver(resize).observe(find("plots"));
  makePlots();
  takePlot(await (await fetch(path("/api/plot"))).json());
  draw();
  if (isRun && !about.read_only) makeCommands(); else find("commands").hidden = true;
  const stimuli = about.stimuli || [];
  find("stimuli").append(...stimuli.map((each) => element("li", {}, each)));
  find("scenario").hidden = !stimuli.length;
  find("readonly").hidden = !(isRun && about.read_only);
  find("controls").hidden = find("messages").hidden = !isRun;
  document.body.classList.toggle("recording", !isRun);
  if (!isRun) makeReplay();
  show(await (await fetch(path("/api/state"))).json());
  if (isRun) connect();
}
start();

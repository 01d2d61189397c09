"use strict";
// Controls of a run: what an operator commands, and what of it is in force.

const FIRST_DEG = 35; // where the form places an obstacle at first
const SLIDE_MS = 100; // between two commands of a slider
const REQUESTS = { open: "Open gate", close: "Close gate", stop: "Stop gate", reset: "Reset ECU" };

// Calls a function with the latest argument, at most once in a time [ms].
function paced(milliseconds, call) {
  let timer = null,
    waiting = null;
  const now = () => {
    if (waiting === null) {
      timer = null;
      return;
    }
    const [value] = waiting;
    waiting = null;
    call(value);
    timer = setTimeout(now, milliseconds);
  };
  return (value) => {
    waiting = [value];
    if (timer === null) now();
  };
}

// A quantity with a slider, a number and its unit; a switch is a button.
class Control {
  constructor(name, spec, command, value = null) {
    this.name = name;
    this.spec = spec;
    const label = element(
      "span",
      { className: "name", title: spec.meaning, id: `label-${name}` },
      spec.label,
    );
    this.clear = element(
      "button",
      { type: "button", className: "clear", title: `clear ${spec.label}`, onclick: () => command(null) },
      "×",
    );
    this.clear.setAttribute("aria-label", `clear ${spec.label}`);
    if (spec.labels.length) {
      this.state = element("span", { className: "name" }, spec.labels[0]);
      this.button = element(
        "button",
        { type: "button", id: `switch-${name}`, onclick: () => command(this.isOn ? 0 : 1) },
        this.action(1),
      );
      this.element = element(
        "div",
        { className: "control switch" },
        label,
        this.state,
        this.button,
        this.clear,
      );
    } else {
      const attributes = {
        step: "any",
        title: `${spec.meaning}; allowed: ${text(spec.low)} to ${text(spec.high)} ${spec.unit}`,
      };
      const step = 10 ** Math.floor(Math.log10((spec.slide_high - spec.slide_low) / 100));
      this.slider = element("input", {
        type: "range",
        min: spec.slide_low,
        max: spec.slide_high,
        ...attributes,
        step,
      });
      this.number = element("input", { type: "number", min: spec.low, max: spec.high, ...attributes });
      this.slider.setAttribute("aria-label", `${spec.label}, slider`);
      this.number.setAttribute("aria-label", spec.label);
      if (value !== null) this.slider.value = this.number.value = value;
      const slid = paced(SLIDE_MS, (given) => command(given));
      this.slider.oninput = () => {
        this.number.value = this.slider.value;
        slid(+this.slider.value);
      };
      this.number.onchange = () => {
        if (this.number.value !== "") {
          this.slider.value = this.number.value;
          command(+this.number.value);
        }
      };
      this.element = element(
        "div",
        { className: "control" },
        label,
        this.slider,
        this.number,
        element("span", { className: "unit" }, spec.unit),
        this.clear,
      );
    }
  }

  // What the button of a switch says that sets it to 0 or 1.
  action(value) {
    return this.spec.actions[value] || `Set to ${this.spec.labels[value]}`;
  }

  get value() {
    return this.number.value === "" ? undefined : +this.number.value;
  }

  // Shows the value now, unless it is being changed, and whether a command holds it.
  show(value, isHeld) {
    this.element.classList.toggle("on", isHeld);
    this.clear.style.visibility = isHeld ? "visible" : "hidden";
    if (typeof value !== "number") return;
    if (this.button) {
      this.isOn = value !== 0;
      const words = [this.spec.labels[this.isOn ? 1 : 0], this.action(this.isOn ? 0 : 1)];
      if (this.state.textContent !== words[0]) this.state.textContent = words[0];
      if (this.button.textContent !== words[1]) this.button.textContent = words[1];
      return;
    }
    if (document.activeElement !== this.slider) this.slider.value = value;
    if (document.activeElement !== this.number && document.activeElement !== this.slider)
      this.number.value = +value.toFixed(2);
  }
}

class Controls {
  constructor(can, post, openAngle) {
    this.can = can;
    this.openAngle = openAngle;
    this.post = post;
    this.set = {};
    this.shown = "";
    this.makeRequests();
    for (const [name, spec] of Object.entries(can.set)) {
      this.set[name] = new Control(
        name,
        name === "hand_force_n" ? { ...spec, label: "Force, + opens" } : spec,
        (value) => post({ set: { [name]: value } }),
      );
      find(name === "hand_force_n" ? "hand" : "set").append(this.set[name].element);
    }
    this.makeObstacle();
    makeFaultForm(can.fault, (content) => post({ fault: content }));
    this.makeRestbus();
    this.makeRecording();
    find("clear").onclick = () => post({ clear: "all" });
  }

  makeRequests() {
    const { request } = this.can;
    find("requests").append(
      ...(request.length
        ? request.map((action) =>
            element(
              "button",
              { type: "button", id: `request-${action}`, onclick: () => this.post({ request: action }) },
              REQUESTS[action] || action,
            ),
          )
        : ["The rig has no [requests]."]),
    );
  }

  makeObstacle() {
    const form = find("obstacle"),
      more = element("details", {}, element("summary", {}, "More"));
    this.rod = {};
    for (const [name, spec] of Object.entries(this.can.obstacle)) {
      const range = name === "angle_deg" ? { slide_low: 0, slide_high: this.openAngle } : {};
      const control = new Control(
        name,
        { ...spec, ...range },
        () => {},
        name === "angle_deg" ? FIRST_DEG : spec.default,
      );
      control.clear.remove();
      this.rod[name] = control;
      (["angle_deg", "stiffness"].includes(name) ? form : more).append(control.element);
    }
    this.meets = element(
      "select",
      { title: "which way the gate meets it" },
      element("option", {}, "closing"),
      element("option", {}, "opening"),
    );
    this.meets.setAttribute("aria-label", "which way the gate meets the obstacle");
    more.append(
      element(
        "div",
        { className: "control text" },
        element("span", { className: "name" }, "Met while"),
        this.meets,
      ),
    );
    form.append(
      more,
      element(
        "div",
        { className: "row" },
        element("button", {}, "Put obstacle"),
        element(
          "button",
          { type: "button", onclick: () => this.post({ clear: "obstacle" }) },
          "Remove obstacle",
        ),
      ),
    );
    submit(form, () => this.put({}));
  }

  // Puts the obstacle as the form describes it, with `changed` keys, which the form then shows.
  put(changed) {
    const content = { meets: this.meets.value };
    for (const [name, value] of Object.entries(changed)) {
      this.rod[name].number.value = this.rod[name].slider.value = value;
    }
    for (const [name, { value, spec }] of Object.entries(this.rod))
      if (value !== undefined && value !== spec.default) content[name] = value;
    this.post({ obstacle: content });
  }

  makeRestbus() {
    const names = find("signal-name"),
      { signal } = this.can,
      shaped = (spec) => ({ ...spec, isSignal: true, default: spec.start });
    find("signal-names").append(...Object.keys(signal).map((name) => element("option", { value: name })));
    names.addEventListener("input", () => {
      const spec = signal[names.value];
      find("signal-value").replaceChildren(
        ...(spec ? [input(names.value, shaped(spec)), ` ${spec.unit}`] : []),
      );
      names.title = spec ? spec.meaning : "";
    });
    submit(find("signal"), () => {
      const field = find("signal-value").querySelector("input"),
        spec = signal[names.value];
      this.post({ signal: { [names.value]: field && spec ? fieldValue(field, shaped(spec)) : null } }); // null: the server says what is allowed
    });
  }

  makeRecording() {
    const stamp = () => new Date().toISOString().slice(0, 19).replaceAll(":", "").replace("T", "-");
    const formats = this.can.record,
      name = find("record-name");
    name.value = `run-${stamp()}${formats.includes(".mf4") ? ".mf4" : formats[0]}`;
    name.title = `a file in the folder of the run, in one of ${formats.join(", ")}`;
    submit(find("record"), () => {
      if (this.recording) {
        this.post({ record: null });
        name.value = `run-${stamp()}.${name.value.split(".").pop()}`;
        return;
      }
      this.post({ record: { file: name.value } });
    });
    submit(find("mark"), async () => {
      if (await this.post({ mark: find("mark-text").value })) find("mark-text").value = "";
    });
  }

  // Shows the values now, and what is in force.
  show(truth, force) {
    for (const [name, control] of Object.entries(this.set))
      control.show(truth[name], name in (force.set || {}));
    this.recording = force.record || null;
    const button = find("record-button"),
      words = this.recording
        ? this.recording.phase === "recording"
          ? `Stop ${this.recording.file}`
          : `${this.recording.phase} …`
        : "Record";
    if (button.textContent !== words) button.textContent = words;
    button.classList.toggle("on", Boolean(this.recording));
    find("record-name").hidden = Boolean(this.recording);
    const shown = JSON.stringify(force);
    if (shown === this.shown) return;
    this.shown = shown;
    this.showRod(force.obstacle || {});
    find("clear").textContent = `Clear all: ${inForce(force).join(", ") || "nothing is commanded"}`;
    const label = (each) => this.can.fault[each.kind]?.label || each.kind;
    const inWords = ({ kind, where, ...rest }) =>
      [label({ kind }), where, ...Object.entries(rest).map(([name, value]) => `${name} ${text(value)}`)]
        .filter(Boolean)
        .join(" ");
    this.chips(
      "fault-on",
      (force.faults || []).map((each) => [inWords(each), { clear: { fault: each } }]),
    );
    const rod = force.obstacle,
      about =
        rod &&
        Object.entries(rod)
          .filter(([name, value]) => name !== "meets" || value !== "closing")
          .map(([name, value]) =>
            `${this.rod[name]?.spec.label.toLowerCase() || name} ${text(value)} ${this.rod[name]?.spec.unit || ""}`.trim(),
          );
    this.chips("obstacle-on", rod ? [[about.join(", "), { clear: "obstacle" }]] : []);
    this.chips(
      "signal-on",
      Object.entries(force.signals || {}).map(([name, value]) => [
        `${name} = ${text(value)}`,
        { clear: { signal: name } },
      ]),
    );
  }

  // The obstacle's form shows the one in force, whoever put it, unless a field of it is being changed.
  showRod(obstacle) {
    for (const [name, value] of Object.entries(obstacle)) {
      const { number, slider } = this.rod[name] || {};
      if (!number || [number, slider].includes(document.activeElement)) continue;
      number.value = slider.value = value;
    }
    if (obstacle.meets && document.activeElement !== this.meets) this.meets.value = obstacle.meets;
  }

  chips(id, each) {
    find(id).replaceChildren(
      ...each.map(([words, command]) => {
        const button = element("button", { type: "button", onclick: () => this.post(command) }, "×");
        button.setAttribute("aria-label", `clear ${words}`);
        return element("li", {}, words, button);
      }),
    );
  }
}

// What was commanded and is in force, in words.
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

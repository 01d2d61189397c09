"use strict";
// Controls of a run: what an operator commands, and what of it is in force.

const FIRST_DEG = 35; // where the form places an obstacle at first
const SLIDE_MS = 100; // between two commands of a slider
const MOST_LISTED = 20; // signals that a refusal names
const REQUESTS = { open: "Open gate", close: "Close gate", stop: "Stop gate", reset: "Reset ECU" };
const AFTER_RESET =
  "the ECU restarts. The reference ECU has then forgotten what it learned of the gate: its next motions may reverse " +
  "with nothing in the way";

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
      const title = `${spec.meaning}; allowed: ${allowedIn(spec)}`;
      const step = 10 ** Math.floor(Math.log10((spec.slide_high - spec.slide_low) / 100));
      this.slider = element("input", {
        type: "range",
        min: spec.slide_low,
        max: spec.slide_high,
        title,
        step,
      });
      this.number = numberField(spec, { title });
      this.slider.setAttribute("aria-label", `${spec.label}, slider`);
      this.number.setAttribute("aria-label", spec.label);
      if (value !== null) this.fill(value);
      const slid = paced(SLIDE_MS, (given) => command(given));
      this.slider.oninput = () => {
        fill(this.number, this.slider.value);
        slid(+this.slider.value);
      };
      this.number.onchange = () => {
        const { value: given } = this;
        if (typeof given !== "number") return;
        this.slider.value = given;
        command(given);
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

  // See numberIn.
  get value() {
    return numberIn(this.number, this.spec);
  }

  fill(value) {
    this.slider.value = value;
    fill(this.number, value);
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
      fill(this.number, +value.toFixed(2));
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
              {
                type: "button",
                id: `request-${action}`,
                title: action === "reset" ? AFTER_RESET : "",
                onclick: () => this.post({ request: action }),
              },
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
    for (const [name, value] of Object.entries(changed)) this.rod[name].fill(value);
    for (const [name, { value, spec }] of Object.entries(this.rod)) {
      if (value === null) return;
      if (value !== undefined && value !== spec.default) content[name] = value;
    }
    this.post({ obstacle: content });
  }

  makeRestbus() {
    const names = find("signal-name"),
      { signal } = this.can,
      all = Object.keys(signal),
      shaped = (spec) => ({ ...spec, isSignal: true, default: spec.start });
    names.placeholder = all.length ? `such as ${all[0]}` : "none can be set";
    find("signal-names").append(...all.map((name) => element("option", { value: name })));
    names.addEventListener("input", () => {
      const spec = signal[names.value];
      find("signal-value").replaceChildren(
        ...(spec ? [input(names.value, shaped(spec)), ` ${spec.unit}`] : []),
      );
      names.title = spec ? spec.meaning : "";
    });
    submit(find("signal"), () => {
      const spec = signal[names.value];
      if (!spec) {
        const known = all.slice(0, MOST_LISTED).join(", ") || "none",
          more = all.length > MOST_LISTED ? ` and ${all.length - MOST_LISTED} more` : "";
        answer(`${names.value || "no signal"}: not one that can be set; allowed: ${known}${more}`, true);
        return;
      }
      const value = fieldValue(find("signal-value").querySelector("input"), shaped(spec));
      if (value !== null) this.post({ signal: { [names.value]: value ?? null } });
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
    this.chips(
      "fault-on",
      (force.faults || []).map((each) => [faultWords(each), { clear: { fault: each } }]),
    );
    const rod = force.obstacle;
    this.chips("obstacle-on", rod ? [[obstacleWords(rod), { clear: "obstacle" }]] : []);
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
      const control = this.rod[name];
      if (!control || [control.number, control.slider].includes(document.activeElement)) continue;
      control.fill(value);
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

"use strict";
// Forms: a field for each kind of value, what is in it, and the form of a fault.

// Numbers are entered as text: a field of type number drops letters as they are typed, and 0x6E4 becomes 06E4, 60000.
const DECIMAL = /^[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$/i,
  HEX = /^(0x)?[0-9a-f]+$/i;
const MOST_TOLD = 1e9; // a limit beyond it tells nobody anything

// The number that a text states; NaN: none.
function numberFrom(words, isHex = false) {
  if (!(isHex ? HEX : DECIMAL).test(words)) return NaN;
  return isHex ? parseInt(words, 16) : Number(words);
}

function shownIn(value, { is_hex: isHex }) {
  return isHex ? value.toString(16).toUpperCase() : text(value);
}

// What a value may be, in words.
function allowedIn({ labels = [], low, high, unit, allowed, is_hex: isHex }) {
  if (labels.length) return labels.join(", ");
  if (low === undefined) return allowed || "";
  const kind = isHex ? "a hexadecimal number" : "a number";
  if (low === null || high === null || Math.max(-low, high) > MOST_TOLD) return kind;
  const range = [low, high].map((each) => shownIn(each, { is_hex: isHex })).join(" to ");
  return `${isHex ? `${kind}, ` : ""}${range} ${unit || ""}`.trim();
}

// A field for a number.
function numberField(spec, attributes = {}) {
  const field = element("input", {
    type: "text",
    inputMode: spec.is_hex ? "text" : "decimal",
    autocomplete: "off",
    spellcheck: false,
    ...attributes,
  });
  field.addEventListener("input", () => field.removeAttribute("aria-invalid"));
  return field;
}

function fill(field, value) {
  field.value = value;
  field.removeAttribute("aria-invalid");
}

// The number in a field; undefined: it is empty; null: what is in it is refused, and marked.
function numberIn(field, spec) {
  const words = field.value.trim();
  if (words === "") return undefined;
  const value = numberFrom(words, spec.is_hex);
  if (value >= (spec.low ?? -Infinity) && value <= (spec.high ?? Infinity)) return value;
  field.setAttribute("aria-invalid", "true");
  answer(`${field.getAttribute("aria-label")} ${words}: allowed: ${allowedIn(spec)}`, true);
  return null;
}

// The form of a fault: its fields are those of its kind.
function makeFaultForm(can, inject) {
  const kinds = find("fault-kind"),
    keys = find("fault-keys"),
    groups = {};
  for (const [name, spec] of Object.entries(can)) {
    groups[spec.group] ??= element("optgroup", { label: spec.group });
    groups[spec.group].append(element("option", { value: name }, spec.label));
  }
  kinds.append(...Object.values(groups));
  const field = (label, made) =>
    element("label", { className: "control text" }, element("span", { className: "name" }, label), made);
  const change = () => {
    const kind = can[kinds.value],
      made = [];
    find("fault-meaning").textContent = `${kind.meaning[0].toUpperCase()}${kind.meaning.slice(1)}.`;
    if (kind.where.length) {
      const all = kind.of === "a message" ? ["", ...kind.where] : kind.where;
      made.push(
        field(
          kind.of === "a message" ? "Message" : "Drive",
          element(
            "select",
            { name: "where" },
            ...all.map((name) => element("option", { value: name }, name || "all")),
          ),
        ),
      );
    }
    for (const [name, spec] of Object.entries(kind.keys))
      made.push(field(spec.unit ? `${spec.label} [${spec.unit}]` : spec.label, input(name, spec)));
    keys.replaceChildren(...made);
  };
  kinds.onchange = change;
  change();
  submit(find("fault"), () => {
    const content = { kind: kinds.value },
      specs = can[kinds.value].keys;
    for (const each of keys.querySelectorAll("input, select")) {
      const value = fieldValue(each, specs[each.name] || {});
      if (value === null) return;
      if (value !== undefined) content[each.name] = value;
    }
    inject(content);
  });
}

// An input for a value: labels to choose from, else a number with its range, else a text.
function input(key, spec) {
  const labels = spec.labels || [],
    begin = spec.typical ?? spec.default,
    hasDefault = spec.default !== null && spec.default !== undefined;
  let made;
  if (labels.length && spec.isSignal) {
    // which may have other values, too
    made = element("input", { type: "text", required: true });
    made.setAttribute("list", "signal-labels");
    find("signal-labels").replaceChildren(...labels.map((label) => element("option", { value: label })));
  } else if (labels.length) {
    made = element("select", {}, ...labels.map((label) => element("option", { value: label }, label)));
  } else if (spec.low !== undefined) {
    made = numberField(spec, { required: !hasDefault });
  } else {
    made = element("input", { type: "text", required: !hasDefault });
  }
  if (begin !== null && begin !== undefined && made.tagName === "INPUT")
    made.value = typeof begin === "number" ? shownIn(begin, spec) : begin;
  made.name = key;
  made.title = `${spec.meaning || key}; allowed: ${allowedIn(spec)}`;
  made.setAttribute("aria-label", spec.label || key);
  return made;
}

// What a field says; undefined: it is empty; null: it is refused.
function fieldValue(field, spec) {
  const isNumber = spec.low !== undefined,
    hasLabels = (spec.labels || []).length > 0;
  if (isNumber && !hasLabels) return numberIn(field, spec);
  const words = field.value.trim();
  if (words === "") return undefined;
  const value = isNumber ? numberFrom(words) : NaN; // a signal with labels may have other values, too
  return Number.isNaN(value) ? words : value;
}

function submit(form, action) {
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    action();
  });
}

"use strict";
// Forms: a field for each kind of value, and the form of a fault.

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
      const value = fieldValue(each, specs[each.name] || { labels: ["x"] });
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
    made = element("input", {
      type: "number",
      step: "any",
      min: spec.low,
      max: spec.high,
      required: !hasDefault,
    });
  } else {
    made = element("input", { type: "text", required: !hasDefault });
  }
  if (begin !== null && begin !== undefined && made.tagName === "INPUT") made.value = begin;
  made.name = key;
  const range =
    spec.low === undefined
      ? spec.allowed || ""
      : `${text(spec.low)} to ${text(spec.high)} ${spec.unit || ""}`;
  made.title = `${spec.meaning || key}; allowed: ${labels.length ? labels.join(", ") : range}`;
  made.setAttribute("aria-label", spec.label || key);
  return made;
}

function fieldValue(field, spec) {
  if (field.value === "") return undefined;
  if (spec.isSignal) return Number.isNaN(Number(field.value)) ? field.value : Number(field.value);
  return spec.low !== undefined && !(spec.labels || []).length ? Number(field.value) : field.value;
}

function submit(form, action) {
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    action();
  });
}

"use strict";
// Elements of the page and texts in them.

const token = new URLSearchParams(location.search).get("token") || "";
const find = (id) => document.getElementById(id);
const path = (name) => `${name}${name.includes("?") ? "&" : "?"}token=${encodeURIComponent(token)}`;

function text(value, digits = 4) {
  if (value === null || value === undefined) return "–";
  if (typeof value !== "number") return String(value);
  if (Number.isInteger(value)) return String(value);
  return Math.abs(value) >= 1e6 || (value !== 0 && Math.abs(value) < 1e-4)
    ? value.toExponential(3)
    : String(+value.toFixed(digits));
}

function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key in made) made[key] = value;
    else made.setAttribute(key, value);
  }
  made.append(...children);
  return made;
}

// A decimal comma becomes a decimal point as it is typed, so that everybody sees what it is taken for.
addEventListener("beforeinput", (event) => {
  if (event.target.inputMode !== "decimal" || event.inputType !== "insertText" || event.data !== ",") return;
  event.preventDefault();
  document.execCommand("insertText", false, ".");
});

function rows(table, made) {
  const body = table.tBodies[0];
  while (body.rows.length > made.length) body.deleteRow(-1);
  made.forEach((cells, r) => {
    const row = body.rows[r] || body.insertRow();
    cells.forEach((value, c) => {
      const cell = row.cells[c] || row.insertCell();
      if (value instanceof Node) {
        if (cell.firstChild !== value) cell.replaceChildren(value);
        return;
      }
      const words = text(value);
      if (cell.textContent !== words) cell.textContent = words;
      if (c > 0) cell.className = "mono";
    });
  });
}

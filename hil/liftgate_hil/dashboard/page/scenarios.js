"use strict";
// Scenarios that the page starts: a list by folders, with what each is about and how it ended last.

const FILTERED = 8; // scenarios from which on there is a field to find one

const chosenScenario = () => find("scenario-list").querySelector("input:checked")?.value;

async function listScenarios() {
  const found = await ask("/api/run");
  if (!found) return;
  const { scenarios, running, is_all: isAll } = found,
    shown =
      chosenScenario() ||
      running ||
      scenarios.find(({ name }) => about.scenario && about.scenario.endsWith(`/${name}`))?.name ||
      scenarios[0]?.name;
  const folders = new Map();
  for (const each of scenarios) {
    const folder = each.name.slice(0, each.name.lastIndexOf("/") + 1);
    if (!folders.has(folder)) folders.set(folder, []);
    folders.get(folder).push(scenarioEntry(each, each.name === shown));
  }
  find("scenario-list").replaceChildren(
    ...[...folders].map(([folder, entries]) =>
      element(
        "fieldset",
        {},
        element("legend", { hidden: folders.size < 2 }, folder || "this folder"),
        ...entries,
      ),
    ),
  );
  find("scenario-filter").hidden = scenarios.length < FILTERED;
  filterScenarios();
  find("scenario-more").textContent = isAll
    ? scenarios.length
      ? ""
      : "The folder has no scenario files."
    : "The folder has more files than are listed: choose one below it with --scenarios.";
  find("scenario-list").querySelector("input:checked")?.closest("label").scrollIntoView({ block: "nearest" });
}

function scenarioEntry({ name, description, requirement, issue, verdict }, isChosen) {
  const words = issue || description;
  return element(
    "label",
    { className: "scenario", title: name },
    element("input", { type: "radio", name: "scenario", value: name, checked: isChosen }),
    element("b", {}, name.slice(name.lastIndexOf("/") + 1).replace(/\.toml$/, "")),
    ...requirement.map((each) => element("span", { className: "requirement" }, each)),
    ...(verdict ? [element("span", { className: `badge ${verdict}`, title: "the last run" }, verdict)] : []),
    ...(words ? [element("span", { className: issue ? "meaning bad" : "meaning" }, words)] : []),
  );
}

function filterScenarios() {
  const wanted = find("scenario-filter").value.toLowerCase().split(/\s+/).filter(Boolean);
  for (const group of find("scenario-list").children) {
    for (const entry of group.querySelectorAll("label"))
      entry.hidden = !wanted.every((word) => `${entry.title} ${entry.textContent}`.toLowerCase().includes(word));
    group.hidden = !group.querySelector("label:not([hidden])");
  }
  const shown = [...find("scenario-list").querySelectorAll("label:not([hidden])")];
  find("scenario-none").hidden = shown.length > 0 || !wanted.length;
  find("start-run").disabled = !shown.some((entry) => entry.querySelector("input").checked);
}

function makeStart() {
  find("starting").hidden = false;
  listScenarios();
  find("scenario-filter").oninput = filterScenarios;
  find("scenario-list").onchange = filterScenarios;
  submit(find("start"), async () => {
    const name = chosenScenario();
    if (!name) return;
    answer(`starting ${name} …`, false);
    if (await post("/api/run", { scenario: name })) answer("", false);
  });
  find("stop-run").onclick = async () => {
    if (await post("/api/run", { scenario: null })) answer("", false);
  };
}

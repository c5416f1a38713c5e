"use strict";

// The table of best known flights: one scenario at a time, sorted and filtered.
(() => {
  const DATA = JSON.parse(document.getElementById("data").textContent);
  const find = (id) => document.getElementById(id);
  const percent = (value) => (value === null ? "" : (100 * value).toFixed(2));
  const mean = (values) => values.reduce((sum, value) => sum + value, 0) / values.length;
  const COLUMNS = [
    { name: "episode", title: "Episode", show: episode, first: "ascending" },
    { name: "cral", title: "CRAL %", show: (row) => percent(row.cral) },
    { name: "bound", title: "Upper bound %", show: (row) => percent(row.bound) },
    { name: "gap", title: "Gap", show: (row) => (row.proved ? "optimal" : percent(row.gap)) },
    { name: "steps", title: "Steps", show: (row) => row.steps, first: "ascending" },
    { name: "agent", title: "Agent", show: agent, first: "ascending" },
    { name: "date", title: "Since", show: (row) => row.date },
  ];
  let sorting = { column: COLUMNS[0], direction: "ascending" };

  function element(name, attributes = {}, ...children) {
    const made = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    made.append(...children);
    return made;
  }

  function episode(row) {
    const where = `index.html#${find("scenario").value}/${row.watch}/${row.episode}`;
    return row.watch === null ? row.episode : element("a", { href: where, title: "watch this flight" }, row.episode);
  }

  function agent(row) {
    return element("span", { title: row.authors }, row.agent);
  }

  // The episodes of the chosen scenario.
  function rowsOf(id) {
    const told = DATA[id];
    return told.episodes.map((number, k) => {
      const [name, authors] = told.authors[told.by[k]], bound = told.bound[k], cral = told.cral[k];
      const gap = bound === null ? null : Math.max(0, bound - cral);
      return { episode: number, cral, bound, gap, proved: told.proved[k], steps: told.steps[k], agent: name, authors, date: told.dates[told.date[k]], watch: told.watch[k] };
    });
  }

  function show() {
    const all = rowsOf(find("scenario").value), names = [...new Set(all.map((row) => row.agent))].sort();
    const chosen = find("agent").value;
    const count = (name) => all.filter((row) => row.agent === name).length;
    find("agent").replaceChildren(new Option("all", ""), ...names.map((name) => new Option(`${name} (${count(name)})`, name)));
    find("agent").value = names.includes(chosen) ? chosen : "";
    const agent = find("agent").value, open = find("open").value;
    const rows = all.filter((row) => (!agent || row.agent === agent) && (!open || row.proved === (open === "proved")));
    const { column, direction } = sorting, sign = direction === "ascending" ? 1 : -1;
    rows.sort((a, b) => {
      const [x, y] = [a[column.name], b[column.name]];
      if ((x === null) !== (y === null)) return x === null ? 1 : -1; // what is not known comes last, either way
      return sign * (x > y ? 1 : x < y ? -1 : 0) || a.episode - b.episode;
    });
    for (const head of find("best").tHead.rows[0].cells) {
      head.setAttribute("aria-sort", head.dataset.column === column.name ? direction : "none");
    }
    find("best").tBodies[0].replaceChildren(...rows.map((row) => {
      const line = element("tr", { "data-episode": row.episode });
      for (const each of COLUMNS) line.append(element("td", { class: each.name === "agent" ? "name" : each.name }, each.show(row)));
      return line;
    }));
    const bounded = all.filter((row) => row.gap !== null), parts = [`${all.length.toLocaleString("en")} episodes`, `mean CRAL ${percent(mean(all.map((row) => row.cral)))} %`];
    if (bounded.length) {
      const proved = all.filter((row) => row.proved).length;
      if (proved) parts.push(`${proved.toLocaleString("en")} proved optimal`);
      parts.push(`mean gap to the bound ${percent(mean(bounded.map((row) => row.gap)))} points over ${bounded.length.toLocaleString("en")} episodes`);
    }
    find("summary").textContent = `${parts.join(", ")}.`;
    history.replaceState(null, "", `#${find("scenario").value}`);
  }

  for (const column of COLUMNS) {
    const head = element("th", { scope: "col", class: column.name === "agent" ? "name" : column.name, "data-column": column.name }, element("button", { type: "button" }, column.title));
    head.firstChild.addEventListener("click", () => {
      const turned = sorting.direction === "ascending" ? "descending" : "ascending";
      sorting = { column, direction: sorting.column === column ? turned : column.first || "descending" };
      show();
    });
    find("best").tHead.rows[0].append(head);
  }
  for (const name of Object.keys(DATA)) find("scenario").append(new Option(name, name));
  const named = Object.keys(DATA).find((name) => `#${name}` === location.hash);
  if (named) find("scenario").value = named;
  find("filters").addEventListener("input", show);
  find("filters").addEventListener("submit", (event) => event.preventDefault());
  show();
})();

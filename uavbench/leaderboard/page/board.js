"use strict";

// The table: sorted, filtered, with bars; and the scatter of what it shows.
const DATA = JSON.parse(document.getElementById("data").textContent);

(() => {
  const find = (id) => document.getElementById(id);
  const percent = (value) => (value === null ? "" : value.toFixed(1));
  const gap = (value, known, of) => percent(value) + (value !== null && known < of ? ` (${known.toLocaleString("en")})` : "");
  const count = (value) => (value === null ? "" : value.toLocaleString("en", { maximumFractionDigits: value < 10 ? 1 : 0 }));
  const score = (interval) => interval[0];
  const COLUMNS = [
    { name: "rank", title: "Rank", value: (row) => row.rank, show: (row) => row.rank ?? "–", first: "ascending" },
    { name: "name", title: "Agent", value: (row) => row.name.toLowerCase(), show: agent, first: "ascending" },
    { name: "cral", title: "CRAL %", value: (row) => score(row.cral), show: (row) => bar(row.cral) },
    { name: "cr", title: "CR %", value: (row) => score(row.cr), show: (row) => bar(row.cr) },
    { name: "landed", title: "Landed %", value: (row) => score(row.landed), show: (row) => bar(row.landed) },
    { name: "iqm", title: "IQM %", value: (row) => row.iqm, show: (row) => percent(row.iqm) },
    { name: "best", title: "Gap to best", value: (row) => row.gap_to_best, show: (row) => gap(row.gap_to_best, row.compared, row.episodes), first: "ascending" },
    { name: "bound", title: "Gap to bound", value: (row) => row.gap_to_bound, show: (row) => gap(row.gap_to_bound, row.bounded, row.episodes), first: "ascending" },
    { name: "steps", title: "Steps", value: (row) => row.steps, show: (row) => percent(row.steps) },
    { name: "speed", title: "Decisions/s, claimed", value: (row) => row.decisions_per_second, show: (row) => count(row.decisions_per_second) },
  ];
  let sorting = { column: COLUMNS[2], direction: "descending" };

  function element(name, attributes = {}, ...children) {
    const svg = ["svg", "rect", "line", "circle", "text", "title", "g"].includes(name);
    const made = svg ? document.createElementNS("http://www.w3.org/2000/svg", name) : document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    made.append(...children);
    return made;
  }

  function agent(row) {
    const tier = element("span", { class: `tier ${row.tier}` }, row.tier);
    const name = row.entry ? element("button", { type: "button", class: "open" }, row.name) : element("span", {}, row.name);
    const about = element("small", { title: [row.authors, row.training].filter(Boolean).join(" · ") });
    const claimed = row.track_known_by === "claim";
    const track = element("span", claimed ? { title: "what the agent saw is its authors' word: nobody has run it again" } : {}, row.track + (claimed ? " (claimed)" : ""));
    about.append(track, " · ", row.link ? element("a", { href: row.link, rel: "noopener nofollow" }, row.authors) : row.authors);
    const shown = element("span", {}, name, " ", tier, about);
    if (row.note) shown.append(element("small", { class: "why" }, row.note));
    return shown;
  }

  function bar([mean, low, high]) {
    const shown = element("span", {}, percent(mean));
    if (low === null) return shown;
    shown.title = `${percent(mean)} [${percent(low)}, ${percent(high)}]`;
    const drawn = element("svg", { class: "bar", viewBox: "0 0 100 9", preserveAspectRatio: "none", "aria-hidden": "true" });
    drawn.append(element("rect", { x: 0, y: 1, width: mean, height: 7 }), element("line", { x1: low, x2: high, y1: 4.5, y2: 4.5 }));
    for (const end of [low, high]) drawn.append(element("line", { x1: end, x2: end, y1: 1, y2: 8 }));
    shown.append(element("small", {}, `${percent(low)} – ${percent(high)}`), drawn);
    return shown;
  }

  function chosen() {
    const wanted = find("search").value.trim().toLowerCase(), track = find("track").value;
    return DATA.rows.filter((row) => row.scenario === find("scenario").value && (!track || row.track === track)
      && `${row.name} ${row.authors}`.toLowerCase().includes(wanted));
  }

  function show() {
    const { column, direction } = sorting, sign = direction === "ascending" ? 1 : -1, rows = chosen();
    const known = (row) => column.value(row) !== null;
    rows.sort((a, b) => {
      if (known(a) !== known(b)) return known(a) ? -1 : 1; // what is not known comes last, either way
      const [x, y] = [column.value(a), column.value(b)];
      return sign * (x > y ? 1 : x < y ? -1 : 0);
    });
    for (const head of find("board").tHead.rows[0].cells) {
      head.setAttribute("aria-sort", head.dataset.column === column.name ? direction : "none");
    }
    find("board").tBodies[0].replaceChildren(...rows.map((row) => {
      const line = element("tr", { class: row.entry ? "entry" : "published", "data-name": row.name });
      for (const each of COLUMNS) line.append(element("td", { class: each.name }, each.show(row)));
      if (row.entry) {
        line.addEventListener("click", (event) => {
          if (!event.target.closest("a")) Viewer.open(row.entry, row.scenario);
        });
      }
      return line;
    }));
    find("none").hidden = rows.length > 0;
    scatter(rows.filter((row) => row.decisions_per_second));
    location.replace(`#${find("scenario").value}`);
  }

  function scatter(rows) {
    const width = 860, height = 340, left = 54, bottom = 40, right = 150, top = 16;
    const times = rows.map((row) => 1000 / row.decisions_per_second), values = rows.map((row) => row.cral[0]);
    const low = Math.floor(Math.log10(Math.min(0.01, ...times))), high = Math.ceil(Math.log10(Math.max(1, ...times)));
    const least = Math.max(0, Math.floor(Math.min(95, ...values) / 10) * 10 - 5);
    const x = (time) => left + ((Math.log10(time) - low) / (high - low)) * (width - left - right);
    const y = (value) => height - bottom - ((value - least) / (100 - least)) * (height - bottom - top);
    const drawn = element("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": "CRAL of each agent against the time it takes for a decision" });
    for (let power = low; power <= high; power++) {
      drawn.append(element("line", { class: "axis", x1: x(10 ** power), x2: x(10 ** power), y1: top, y2: height - bottom }));
      drawn.append(element("text", { class: "quiet", x: x(10 ** power), y: height - bottom + 16, "text-anchor": "middle" }, `${10 ** power} ms`));
    }
    for (let value = Math.ceil(least / 10) * 10; value <= 100; value += 10) {
      drawn.append(element("line", { class: "axis", x1: left, x2: width - right, y1: y(value), y2: y(value) }));
      drawn.append(element("text", { class: "quiet", x: left - 8, y: y(value) + 4, "text-anchor": "end" }, value));
    }
    drawn.append(element("text", { class: "quiet", x: left, y: height - 6 }, "time for a decision"));
    rows.forEach((row, k) => {
      const point = element("circle", { class: row.track, cx: x(times[k]), cy: y(values[k]), r: 5 });
      point.append(element("title", {}, `${row.name}: ${percent(values[k])} %, ${times[k].toPrecision(2)} ms`));
      drawn.append(point, element("text", { x: x(times[k]) + 9, y: y(values[k]) + 4 }, row.name));
    });
    find("scatter").replaceChildren(drawn);
  }

  for (const column of COLUMNS) {
    const head = element("th", { scope: "col", class: column.name, "data-column": column.name }, element("button", { type: "button" }, column.title));
    head.firstChild.addEventListener("click", () => {
      const turned = sorting.direction === "ascending" ? "descending" : "ascending";
      sorting = { column, direction: sorting.column === column ? turned : column.first || "descending" };
      show();
    });
    find("board").tHead.rows[0].append(head);
  }
  for (const name of new Set(DATA.rows.map((row) => row.scenario))) find("scenario").append(element("option", { value: name }, name));
  const wanted = location.hash.slice(1); // ids need no escaping
  if (DATA.rows.some((row) => row.scenario === wanted)) find("scenario").value = wanted;
  find("filters").addEventListener("input", show);
  find("filters").addEventListener("submit", (event) => event.preventDefault());
  find("theme").addEventListener("click", () => {
    const dark = matchMedia("(prefers-color-scheme: dark)").matches;
    const now = document.documentElement.dataset.theme || (dark ? "dark" : "light");
    document.documentElement.dataset.theme = now === "dark" ? "light" : "dark";
    Viewer.repaint();
  });
  show();
})();

"use strict";

// The table: sorted, filtered, with bars.
const DATA = JSON.parse(document.getElementById("data").textContent);

(() => {
  const find = (id) => document.getElementById(id);
  const percent = (value) => (value === null ? "" : value.toFixed(1));
  const gap = (value, known, of) => percent(value) + (value !== null && known < of ? ` (${known.toLocaleString("en")})` : "");
  const count = (value) => (value === null ? "" : value.toLocaleString("en", { maximumFractionDigits: value < 10 ? 1 : 0 }));
  const score = (interval) => interval[0];
  const COLUMNS = [
    { name: "rank", title: "Rank", value: (row) => row.rank && row.rank + (row.track === "state" ? DATA.rows.length : 0), show: rank, first: "ascending" },
    { name: "name", title: "Agent", value: (row) => row.name.toLowerCase(), show: agent, first: "ascending" },
    { name: "cral", title: "CRAL %", value: (row) => score(row.cral), show: (row) => bar(row.cral) },
    { name: "cr", title: "CR %", value: (row) => score(row.cr), show: (row) => bar(row.cr) },
    { name: "landed", title: "Landed %", value: (row) => score(row.landed), show: (row) => bar(row.landed) },
    { name: "iqm", title: "IQM %", value: (row) => row.iqm, show: (row) => percent(row.iqm) },
    { name: "best", title: "Gap to best", value: (row) => row.gap_to_best, show: (row) => gap(row.gap_to_best, row.compared, row.episodes), first: "ascending" },
    { name: "bound", title: "Gap to bound", value: (row) => row.gap_to_bound, show: (row) => gap(row.gap_to_bound, row.bounded, row.episodes), first: "ascending" },
    { name: "steps", title: "Steps", value: (row) => row.steps, show: (row) => percent(row.steps) },
    { name: "speed", title: "Decisions/s, claimed", value: (row) => row.decisions_per_second, show: (row) => count(row.decisions_per_second) },
    { name: "safety", title: "Flown safely", value: (row) => (row.safety.length ? safe(row.safety) : null), show: safety },
  ];
  let sorting = { column: COLUMNS[2], direction: "descending" };

  function element(name, attributes = {}, ...children) {
    const svg = ["svg", "rect", "line"].includes(name);
    const made = svg ? document.createElementNS("http://www.w3.org/2000/svg", name) : document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    made.append(...children);
    return made;
  }

  // Ranks are of a track: with both shown, each says of which.
  function rank(row) {
    if (row.rank === null) return "–";
    return find("track").value ? row.rank : element("span", { title: `${row.track} track, rank ${row.rank}` }, `${row.track[0].toUpperCase()}${row.rank}`);
  }

  function agent(row) {
    const tier = element("span", { class: `tier ${row.tier}` }, row.tier);
    const name = row.entry ? element("button", { type: "button", class: "open" }, row.name) : element("span", {}, row.name);
    const about = element("small", { title: [row.authors, row.training].filter(Boolean).join(" · ") });
    const claimed = row.track_known_by === "claim";
    const track = element("span", claimed ? { title: "what the agent saw is its authors' word: nobody has run it again" } : {}, row.track + (claimed ? " (claimed)" : ""));
    about.append(track, " · ", ...(row.method ? [row.method, " · "] : []), row.link ? element("a", { href: row.link, rel: "noopener nofollow" }, row.authors) : row.authors);
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

  function safe(flights) {
    const sum = (part) => flights.reduce((total, each) => total + each[part], 0);
    return sum("safe") / sum("flown");
  }

  // By speed, the share of the flights that a simulated quadrotor survived.
  function safety(row) {
    const shown = element("span");
    for (const { speed, safe, flown } of row.safety) {
      shown.append(element("small", { title: `${safe} of ${flown} flights` }, `${Math.round((100 * safe) / flown)} % at ${speed} m/s`));
    }
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
    const without = !rows.some((row) => row.safety.length); // most scenarios' flights have not been flown with physics
    for (const id of ["board", "flown"]) find(id).classList.toggle("unflown", without);
    find("board").tBodies[0].replaceChildren(...rows.map((row) => {
      const line = element("tr", { class: `${row.tier === "published" ? "published" : "entry"}${row.entry ? " opens" : ""}`, "data-name": row.name });
      for (const each of COLUMNS) line.append(element("td", { class: each.name }, each.show(row)));
      if (row.entry) {
        line.addEventListener("click", (event) => {
          if (!event.target.closest("a")) Viewer.open(row.entry, row.scenario);
        });
      }
      return line;
    }));
    find("none").hidden = rows.length > 0;
    find("unseen").hidden = !rows.some((row) => row.tier !== "published" && !row.entry);
    find("ranks").textContent = find("track").value
      ? "Agents are ranked within their track."
      : "Agents are ranked within their track: O1 is the first of the observation track, S1 of the state track.";
    Scatter.draw(rows.filter((row) => row.decisions_per_second));
    Viewer.remember();
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
  // Go where the address says: #scenario, or #scenario/agent/episode. What names nothing here changes nothing.
  function follow() {
    let parts = [];
    try {
      parts = location.hash.slice(1).split("/").map(decodeURIComponent);
    } catch { /* no text */ }
    const [where, entry, episode] = parts;
    if (DATA.rows.some((row) => row.scenario === where)) find("scenario").value = where;
    if (Object.hasOwn(DATA.flights, `${entry}/${where}`)) Viewer.open(entry, where, episode);
    else if (!find("viewer").hidden) Viewer.close();
    show();
  }

  find("filters").addEventListener("input", show);
  find("filters").addEventListener("submit", (event) => event.preventDefault());
  find("theme").addEventListener("click", () => {
    const dark = matchMedia("(prefers-color-scheme: dark)").matches;
    const now = document.documentElement.dataset.theme || (dark ? "dark" : "light");
    document.documentElement.dataset.theme = now === "dark" ? "light" : "dark";
    Viewer.repaint();
  });
  window.addEventListener("hashchange", follow);
  follow();
})();

"use strict";

// The replay viewer: one flight, or two on the same episode.
const Viewer = (() => {
  const find = (id) => document.getElementById(id);
  const ACTIONS = ["north", "east", "south", "west", "hover", "land"];
  const COLOURS = {
    light: { ".": "#ffffff", L: "#9db8ea", N: "#f3b5ad", "#": "#6d747c", b: "#b3b8bd", stripe: "#d0665a", left: "#3fa25b", done: "#cfe8d6", grid: "#e8eaec", crash: "#c81010", shade: "#0000001f", path: "#333a41", uav: "#c2410c", view: "#eab30873" },
    dark: { ".": "#22272c", L: "#2c4a86", N: "#6f2f28", "#": "#8b939b", b: "#596067", stripe: "#b5564a", left: "#45b06a", done: "#28402f", grid: "#2d3338", crash: "#f04444", shade: "#ffffff1c", path: "#d5dade", uav: "#fb923c", view: "#facc1559" },
  };
  const SERVED = ["#d97706", "#2563eb", "#9333ea", "#0d9488", "#dc2626", "#65a30d", "#db2777", "#0891b2", "#a16207", "#4f46e5"];
  const scenarios = new Map(), flights = new Map();
  let panes = [], time = 0, timer = null, opener = null, latest = 0;

  const theme = () => document.documentElement.dataset.theme || (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");

  async function scenario(id) {
    if (!scenarios.has(id)) {
      const told = DATA.scenarios[id];
      const columns = Object.fromEntries(Object.entries(told.episodes).map(([name, k]) => [name, DATA.columns[k]]));
      const cities = await World.citiesOf(told), episodes = await World.unpackAll(columns);
      scenarios.set(id, { ...told, quantile: DATA.quantile, city: cities(0), cities, episodes });
    }
    return scenarios.get(id);
  }

  // The scenario with the city of a test episode.
  const inCity = (where, episode) => ({ ...where, city: where.cities(episode) });

  async function flight(name) {
    if (!flights.has(name)) {
      const { picks, ...packed } = DATA.flights[name], { lengths, actions } = await World.unpackAll(packed);
      const offsets = [0];
      for (const length of lengths.values) offsets.push(offsets.at(-1) + length);
      flights.set(name, { offsets, actions: actions.values, picks, episodes: lengths.values.length });
    }
    return flights.get(name);
  }

  const agents = () => [...new Set(Object.keys(DATA.flights).map((name) => name.split("/")[0]))];
  const flown = (agent) => Object.keys(DATA.flights).filter((name) => name.split("/")[0] === agent).map((name) => name.split("/")[1]);
  const title = (agent) => DATA.names[agent] || agent;

  function fill(select, values, chosen, text = (value) => value) {
    select.replaceChildren(...values.map((value) => new Option(text(value), value)));
    if (values.includes(chosen)) select.value = chosen;
  }

  // Open the viewer with an entry, on the scenario of the table or the first that it has flown, and an episode or the median one.
  async function open(entry, where, episode) {
    opener = title(entry);
    fill(find("first"), agents(), entry, title);
    fill(find("where"), flown(entry), where);
    others("");
    find("viewer").hidden = false;
    find("viewer").scrollIntoView({ behavior: "smooth", block: "start" });
    find("viewer-title").focus({ preventScroll: true });
    find("episode").value = episode ?? "";
    await (find("episode").value ? load() : pick("median"));
  }

  // Write into the address what is shown, so that it can be shared: #scenario/agent/episode, or #scenario without a flight.
  function remember() {
    const parts = find("viewer").hidden ? [find("scenario").value] : [find("where").value, find("first").value, find("episode").value];
    const address = `#${parts.map(encodeURIComponent).join("/")}`;
    history.replaceState(null, "", address);
    find("link").href = address;
  }

  function others(chosen) {
    const there = agents().filter((agent) => agent !== find("first").value && flown(agent).includes(find("where").value));
    fill(find("second"), ["", ...there], chosen, (agent) => (agent ? title(agent) : "nobody"));
  }

  async function pick(which) {
    const { picks } = await flight(`${find("first").value}/${find("where").value}`);
    find("episode").value = picks[which];
    await load();
  }

  async function load() {
    const asked = ++latest;
    pause();
    const where = await scenario(find("where").value);
    const wanted = [find("first").value, find("second").value].filter(Boolean);
    const data = await Promise.all(wanted.map((agent) => flight(`${agent}/${where.id}`)));
    if (asked !== latest) return; // another flight was chosen meanwhile
    const most = Math.min(...data.map((each) => each.episodes)) - 1;
    const episode = Math.max(0, Math.min(most, Math.round(Number(find("episode").value)) || 0));
    find("episode").max = most;
    find("episode").value = episode;
    const there = inCity(where, episode);
    find("many").textContent = (most + 1 < where.recorded ? `of the first ${(most + 1).toLocaleString("en")} of ` : "of ") + where.recorded.toLocaleString("en");
    panes = wanted.map((agent, k) => {
      const { offsets, actions } = data[k], most = where.uavs;
      const taken = actions.subarray(offsets[episode] * most, offsets[episode + 1] * most);
      return { agent, flight: World.fly(there, where.episodes, episode, taken), scenario: there };
    });
    find("panes").replaceChildren(...panes.map((pane) => {
      pane.box = document.createElement("article");
      pane.box.className = "pane";
      pane.box.innerHTML = "<h3></h3><p class=numbers></p><canvas></canvas>";
      pane.box.querySelector("h3").textContent = `${title(pane.agent)} · ${where.id} · episode ${episode}`;
      pane.canvas = pane.box.querySelector("canvas");
      return pane.box;
    }));
    find("time").max = Math.max(...panes.map((pane) => pane.flight.frames.length - 1));
    legend();
    go(0);
    remember();
  }

  // CR and whether all landed, of every flight that can be watched: for tests.
  async function replayAll(agent, id) {
    const [where, { offsets, actions, episodes }] = await Promise.all([scenario(id), flight(`${agent}/${id}`)]);
    return Array.from({ length: episodes }, (_, episode) => {
      const taken = actions.subarray(offsets[episode] * where.uavs, offsets[episode + 1] * where.uavs);
      const { cr, landed } = World.fly(inCity(where, episode), where.episodes, episode, taken);
      return [cr, landed];
    });
  }

  function go(to) {
    time = Math.max(0, Math.min(Number(find("time").max), to));
    find("time").value = time;
    draw();
    if (time === Number(find("time").max)) pause();
  }

  function play() {
    if (time === Number(find("time").max)) go(0);
    timer = setInterval(() => go(time + 1), 1000 / Number(find("speed").value));
    find("play").setAttribute("aria-label", "Pause");
  }

  function pause() {
    clearInterval(timer);
    timer = null;
    find("play").setAttribute("aria-label", "Play");
  }

  // After a change between light and dark.
  function repaint() {
    if (panes.length) legend();
    draw();
  }

  function draw() {
    find("step").textContent = `${time}/${find("time").max}`;
    for (const pane of panes) {
      const now = Math.min(time, pane.flight.frames.length - 1), frame = pane.flight.frames[now];
      const cr = (pane.flight.total - frame.remaining) / pane.flight.total, over = now === pane.flight.frames.length - 1;
      const budget = frame.team.map((uav, u) => `${uav.budget}/${pane.flight.budgets[u]}`).join(", ");
      const last = frame.events.filter(Boolean).map((event) => ACTIONS[event.action]).join(", ");
      const end = over ? (pane.flight.landed ? " · landed" : " · crashed") : last && ` · ${last}`;
      pane.box.querySelector(".numbers").textContent = `budget ${budget} · CR ${(100 * cr).toFixed(2)} %${end}`;
      pane.box.dataset.cr = (100 * cr).toFixed(4);
      pane.box.dataset.over = over;
      paint(pane, now, frame);
    }
  }

  function paint({ canvas, flight, scenario: where }, now, frame) {
    const { city } = where, colours = COLOURS[theme()], size = Math.max(8, Math.floor(1024 / Math.max(city.rows, city.cols)));
    const rim = Math.ceil(0.75 * size); // so that devices on the map's edge are drawn as a whole
    canvas.width = city.cols * size + 2 * rim;
    canvas.height = city.rows * size + 2 * rim;
    const g = canvas.getContext("2d"), middle = ([r, c]) => [(c + 0.5) * size, (r + 0.5) * size];
    g.translate(rim, rim);
    g.fillStyle = colours.grid;
    g.fillRect(0, 0, city.cols * size, city.rows * size);
    for (let r = 0; r < city.rows; r++) {
      for (let c = 0; c < city.cols; c++) {
        const cell = r * city.cols + c, covered = flight.mission.coveredAt ? flight.mission.coveredAt[cell] : -1;
        if (covered === -1) tile(g, city.at(r, c), c * size, r * size, size - 1, colours);
        else target(g, covered > now ? "left" : "done", city.at(r, c), c * size, r * size, size - 1, colours);
      }
    }
    if (flight.mission.devices) paintShade(g, flight.mission.devices, frame.left, city, size, colours);
    frame.team.forEach((uav, u) => {
      if (uav.done) return;
      if (where.mission.kind === "coverage") {
        g.fillStyle = colours.view;
        for (const cell of World.camera(where, ...uav.position)) {
          g.fillRect((cell % city.cols) * size, Math.floor(cell / city.cols) * size, size, size);
        }
      }
    });
    frame.team.forEach((uav, u) => paintWay(g, flight, u, now, middle, size, colours));
    (flight.mission.devices || []).forEach((device, j) => paintDevice(g, device, frame.left[j], middle(device.cell), size, SERVED[j % SERVED.length], colours));
    frame.team.forEach((uav, u) => {
      const event = frame.events[u], [x, y] = middle(uav.position);
      if (event && event.device >= 0) {
        g.strokeStyle = SERVED[event.device % SERVED.length];
        g.setLineDash([size / 3, size / 4]);
        g.lineWidth = size / 8;
        line(g, [[x, y], middle(flight.mission.devices[event.device].cell)]);
        g.setLineDash([]);
      }
      if (uav.done) (uav.landed ? paintEnd : paintCrash)(g, [x, y], size, colours);
      else disc(g, [x, y], size * 0.42, colours.uav, colours["."]);
      if (frame.team.length > 1) {
        g.fillStyle = colours["."];
        g.font = `bold ${size * 0.6}px sans-serif`;
        g.textAlign = "center";
        g.textBaseline = "middle";
        g.fillText(u + 1, x, y + size * 0.04);
      }
    });
  }

  // A cell of the map; no-fly zones are striped, so that they are told from all else without their colour.
  function tile(g, kind, x, y, size, colours) {
    g.fillStyle = colours[kind];
    g.fillRect(x, y, size, size);
    if (kind !== "N") return;
    g.strokeStyle = colours.stripe;
    g.lineWidth = size / 10;
    line(g, [[x, y + size / 2], [x + size / 2, y]]);
    line(g, [[x, y + size], [x + size, y]]);
    line(g, [[x + size / 2, y + size], [x + size, y + size / 2]]);
  }

  // A target cell; the zone that it is in, if any, is an inset square.
  function target(g, state, kind, x, y, size, colours) {
    g.fillStyle = colours[state];
    g.fillRect(x, y, size, size);
    if (kind === ".") return;
    g.fillStyle = colours[kind];
    g.fillRect(x + size * 0.3, y + size * 0.3, size * 0.4, size * 0.4);
  }

  // Where no device that still has data is in line of sight.
  function paintShade(g, devices, left, city, size, colours) {
    const seen = devices.filter((_, j) => left[j] > 0).map((device) => city.visible(...device.cell, city.rows + city.cols));
    if (!seen.length) return;
    g.fillStyle = colours.shade;
    for (let cell = 0; cell < city.cells.length; cell++) {
      if (!"#b".includes(city.cells[cell]) && !seen.some((view) => view[cell])) {
        g.fillRect((cell % city.cols) * size, Math.floor(cell / city.cols) * size, size, size);
      }
    }
  }

  function paintWay(g, flight, u, now, middle, size, colours) {
    const frames = flight.frames.slice(0, now + 1);
    g.lineWidth = size / 6;
    for (let t = 1; t < frames.length; t++) {
      const event = frames[t].events[u];
      if (!event) break;
      const colour = event.device >= 0 ? SERVED[event.device % SERVED.length] : colours.path;
      g.strokeStyle = colour;
      if (event.action === World.HOVER) cross(g, middle(event.from), size * 0.22);
      else line(g, [middle(event.from), middle(event.to)]);
    }
    paintStart(g, middle(frames[0].team[u].position), size, colours);
  }

  // Where a flight begins: a hollow diamond. Where it ends: a full one, or the cross of a crash.
  function paintStart(g, at, size, colours) {
    diamond(g, at, size * 0.62, colours.path);
    diamond(g, at, size * 0.38, colours["."]);
  }
  function paintEnd(g, at, size, colours) {
    diamond(g, at, size * 0.62, colours["."]);
    diamond(g, at, size * 0.52, colours.path);
  }
  function paintCrash(g, at, size, colours) {
    disc(g, at, size * 0.5, colours.crash, colours["."]);
    g.strokeStyle = colours["."];
    g.lineWidth = size / 8;
    cross(g, at, size * 0.2);
  }

  function paintDevice(g, device, left, [x, y], size, colour, colours) {
    g.fillStyle = colours["."];
    g.strokeStyle = colour;
    g.lineWidth = size / 7;
    g.beginPath();
    g.arc(x, y, size * 0.55, 0, 2 * Math.PI);
    g.fill();
    g.stroke();
    g.fillStyle = colour;
    g.beginPath();
    g.moveTo(x, y);
    g.arc(x, y, size * 0.55, -Math.PI / 2, -Math.PI / 2 + 2 * Math.PI * (left / device.data));
    g.fill();
  }

  function line(g, points) {
    g.beginPath();
    points.forEach(([x, y], k) => (k ? g.lineTo(x, y) : g.moveTo(x, y)));
    g.stroke();
  }
  function cross(g, [x, y], half) {
    line(g, [[x - half, y - half], [x + half, y + half]]);
    line(g, [[x - half, y + half], [x + half, y - half]]);
  }
  function disc(g, [x, y], radius, colour, rim) {
    g.beginPath();
    g.arc(x, y, radius, 0, 2 * Math.PI);
    g.fillStyle = colour;
    g.fill();
    g.strokeStyle = rim;
    g.lineWidth = radius / 5;
    g.stroke();
  }
  function diamond(g, [x, y], half, colour) {
    g.fillStyle = colour;
    g.beginPath();
    [[0, -half], [half, 0], [0, half], [-half, 0]].forEach(([right, down], k) => (k ? g.lineTo(x + right, y + down) : g.moveTo(x + right, y + down)));
    g.fill();
  }

  // Every mark of the flights that are shown, drawn as it is on the map.
  function legend() {
    const colours = COLOURS[theme()], { mission, uavs, city: { cells } } = panes[0].scenario, size = 32, middle = [size / 2, size / 2];
    const colour = (name) => (g) => {
      g.fillStyle = colours[name];
      g.fillRect(0, 0, size, size);
    };
    const way = (g) => {
      g.lineWidth = size / 6;
      line(g, [[0, size / 2], [size, size / 2]]);
    };
    const stroke = (shape) => (g) => {
      g.strokeStyle = colours.path;
      g.lineWidth = size / 8;
      shape(g);
    };
    const cell = (kind) => (g) => tile(g, kind, 0, 0, size, colours);
    const marks = {
      "landing zone": cell("L"), "no-fly zone": cell("N"), building: cell("#"), ...(cells.includes("b") ? { "low building": cell("b") } : {}),
      [uavs > 1 ? "UAV, with its number" : "UAV"]: (g) => disc(g, middle, size * 0.42, colours.uav, colours["."]),
      start: (g) => paintStart(g, middle, size * 0.8, colours), landed: (g) => paintEnd(g, middle, size * 0.8, colours),
      crashed: (g) => paintCrash(g, middle, size * 0.9, colours), hover: stroke((g) => cross(g, middle, size * 0.3)),
    };
    if (mission.kind === "coverage") Object.assign(marks, {
      path: stroke(way), "to cover": colour("left"), covered: colour("done"),
      "to cover, in a no-fly zone": (g) => target(g, "left", "N", 0, 0, size, colours),
      "to cover, in a landing zone": (g) => target(g, "left", "L", 0, 0, size, colours),
      "camera's view": colour("view"),
    });
    else Object.assign(marks, {
      "device, filled by the data it has left": (g) => paintDevice(g, { data: 3 }, 2, middle, size * 0.75, SERVED[0], colours),
      "path, in the colour of the device served most": (g) => { g.strokeStyle = SERVED[0]; way(g); },
      "the device being served": (g) => { g.strokeStyle = SERVED[0]; g.setLineDash([size / 4, size / 6]); way(g); },
      "in no device's sight": colour("shade"),
    });
    find("legend").replaceChildren(...Object.entries(marks).map(([name, paintMark]) => {
      const item = document.createElement("li"), icon = document.createElement("canvas");
      icon.width = icon.height = size;
      const g = icon.getContext("2d");
      colour(".")(g);
      paintMark(g);
      item.append(icon, name);
      return item;
    }));
  }

  function key(event) {
    if (find("viewer").hidden || event.altKey || event.ctrlKey || event.metaKey) return; // those are the browser's
    if (/^(INPUT|SELECT|TEXTAREA)$/.test(event.target.tagName) && event.target.id !== "time") return;
    const does = {
      " ": () => (timer ? pause() : play()), ArrowLeft: () => { pause(); go(time - 1); }, ArrowRight: () => { pause(); go(time + 1); },
      Home: () => go(0), End: () => go(Infinity), Escape: close,
    }[event.key];
    if (!does || (event.key === " " && event.target.tagName === "BUTTON")) return;
    event.preventDefault();
    does();
  }

  function close() {
    pause();
    find("viewer").hidden = true;
    const rows = [...find("board").tBodies[0].rows], row = rows.find((each) => each.dataset.name === opener);
    (row?.querySelector(".open") || find("search")).focus({ preventScroll: true });
    find("board").scrollIntoView({ block: "start" });
    remember();
  }

  find("play").addEventListener("click", () => (timer ? pause() : play()));
  find("back").addEventListener("click", () => { pause(); go(time - 1); });
  find("ahead").addEventListener("click", () => { pause(); go(time + 1); });
  find("time").addEventListener("input", () => { pause(); go(Number(find("time").value)); });
  find("speed").addEventListener("change", () => { if (timer) { pause(); play(); } });
  find("close").addEventListener("click", close);
  find("episode").addEventListener("change", load);
  find("second").addEventListener("change", load);
  find("where").addEventListener("change", () => { others(find("second").value); pick("median"); });
  find("first").addEventListener("change", () => {
    fill(find("where"), flown(find("first").value), find("where").value);
    others(find("second").value);
    pick("median");
  });
  for (const button of document.querySelectorAll("[data-pick]")) button.addEventListener("click", () => pick(button.dataset.pick));
  document.addEventListener("keydown", key);

  return { open, close, remember, repaint, replayAll };
})();

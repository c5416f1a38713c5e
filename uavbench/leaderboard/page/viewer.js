"use strict";

// The replay viewer: one flight, or two on the same episode.
const Viewer = (() => {
  const find = (id) => document.getElementById(id);
  const ACTIONS = ["north", "east", "south", "west", "hover", "land"];
  const COLOURS = {
    light: { ".": "#ffffff", L: "#9db8ea", N: "#efb0a8", "#": "#6d747c", left: "#3fa25b", done: "#cfe8d6", grid: "#e8eaec", shade: "#00000014", path: "#333a41", uav: "#c2410c" },
    dark: { ".": "#22272c", L: "#2c4a86", N: "#7a332b", "#": "#8b939b", left: "#45b06a", done: "#28402f", grid: "#2d3338", shade: "#ffffff12", path: "#d5dade", uav: "#fb923c" },
  };
  const SERVED = ["#d97706", "#2563eb", "#9333ea", "#0d9488", "#dc2626", "#65a30d", "#db2777", "#0891b2", "#a16207", "#4f46e5"];
  const scenarios = new Map(), flights = new Map();
  let panes = [], time = 0, timer = null, opener = null;

  const theme = () => document.documentElement.dataset.theme || (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");

  async function scenario(id) {
    if (!scenarios.has(id)) {
      const told = DATA.scenarios[id];
      const columns = Object.fromEntries(Object.entries(told.episodes).map(([name, k]) => [name, DATA.columns[k]]));
      scenarios.set(id, { ...told, quantile: DATA.quantile, city: new World.City(told.rows), episodes: await World.unpackAll(columns) });
    }
    return scenarios.get(id);
  }

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

  // Open the viewer with an entry, on the scenario of the table or the first that it has flown.
  async function open(entry, where) {
    opener = title(entry);
    fill(find("first"), agents(), entry, title);
    fill(find("where"), flown(entry), where);
    others("");
    find("viewer").hidden = false;
    find("viewer").scrollIntoView({ behavior: "smooth", block: "start" });
    find("viewer-title").focus({ preventScroll: true });
    await pick("median");
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
    pause();
    const where = await scenario(find("where").value);
    const wanted = [find("first").value, find("second").value].filter(Boolean);
    const data = await Promise.all(wanted.map((agent) => flight(`${agent}/${where.id}`)));
    const most = Math.min(...data.map((each) => each.episodes)) - 1;
    const episode = Math.max(0, Math.min(most, Math.round(Number(find("episode").value)) || 0));
    find("episode").max = most;
    find("episode").value = episode;
    find("many").textContent = (most + 1 < where.recorded ? `of the first ${(most + 1).toLocaleString("en")} of ` : "of ") + where.recorded.toLocaleString("en");
    panes = wanted.map((agent, k) => {
      const { offsets, actions } = data[k], most = where.uavs;
      const taken = actions.subarray(offsets[episode] * most, offsets[episode + 1] * most);
      return { agent, flight: World.fly(where, where.episodes, episode, taken), scenario: where };
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
    legend(where);
    go(0);
  }

  // CR and whether all landed, of every flight that can be watched: for tests.
  async function replayAll(agent, id) {
    const [where, { offsets, actions, episodes }] = await Promise.all([scenario(id), flight(`${agent}/${id}`)]);
    return Array.from({ length: episodes }, (_, episode) => {
      const taken = actions.subarray(offsets[episode] * where.uavs, offsets[episode + 1] * where.uavs);
      const { cr, landed } = World.fly(where, where.episodes, episode, taken);
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
    find("play").textContent = "⏸";
    find("play").setAttribute("aria-label", "Pause");
  }

  function pause() {
    clearInterval(timer);
    timer = null;
    find("play").textContent = "▶";
    find("play").setAttribute("aria-label", "Play");
  }

  // After a change between light and dark.
  function repaint() {
    if (panes.length) legend(panes[0].scenario);
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
    canvas.width = city.cols * size;
    canvas.height = city.rows * size;
    const g = canvas.getContext("2d"), middle = ([r, c]) => [(c + 0.5) * size, (r + 0.5) * size];
    for (let r = 0; r < city.rows; r++) {
      for (let c = 0; c < city.cols; c++) {
        const cell = r * city.cols + c, covered = flight.mission.coveredAt ? flight.mission.coveredAt[cell] : -1;
        g.fillStyle = covered === -1 ? colours[city.at(r, c)] : colours[covered > now ? "left" : "done"];
        g.fillRect(c * size, r * size, size - 1, size - 1);
        if (covered !== -1 && city.at(r, c) !== ".") {
          g.fillStyle = colours[city.at(r, c)];
          g.fillRect(c * size + size * 0.3, r * size + size * 0.3, size * 0.4, size * 0.4);
        }
      }
    }
    if (flight.mission.devices) paintShade(g, flight.mission.devices, frame.left, city, size, colours);
    frame.team.forEach((uav, u) => {
      if (uav.done) return;
      if (where.mission.kind === "coverage") {
        g.fillStyle = `${colours.uav}40`;
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
      g.fillStyle = uav.done ? colours.path : colours.uav;
      g.beginPath();
      g.arc(x, y, size * 0.42, 0, 2 * Math.PI);
      g.fill();
      if (frame.team.length > 1) {
        g.fillStyle = colours["."];
        g.font = `${size * 0.6}px sans-serif`;
        g.fillText(u + 1, x - size * 0.17, y + size * 0.21);
      }
    });
  }

  // Where no device that still has data is in line of sight.
  function paintShade(g, devices, left, city, size, colours) {
    const seen = devices.filter((_, j) => left[j] > 0).map((device) => city.visible(...device.cell, city.rows + city.cols));
    if (!seen.length) return;
    g.fillStyle = colours.shade;
    for (let cell = 0; cell < city.cells.length; cell++) {
      if (city.cells[cell] !== "#" && !seen.some((view) => view[cell])) {
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
    diamond(g, middle(frames[0].team[u].position), size * 0.4, colours.path);
    if (frames.at(-1).team[u].done) diamond(g, middle(frames.at(-1).team[u].position), size * 0.55, colours.uav);
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
  function diamond(g, [x, y], half, colour) {
    g.fillStyle = colour;
    g.beginPath();
    [[0, -half], [half, 0], [0, half], [-half, 0]].forEach(([right, down], k) => (k ? g.lineTo(x + right, y + down) : g.moveTo(x + right, y + down)));
    g.fill();
  }

  function legend(where) {
    const colours = COLOURS[theme()], coverage = where.mission.kind === "coverage";
    const shown = { "landing zone": colours.L, "no-fly zone": colours.N, building: colours["#"], UAV: colours.uav };
    if (coverage) Object.assign(shown, { "to cover": colours.left, covered: colours.done, "camera's view": `${colours.uav}40` });
    else Object.assign(shown, { "in no device's sight": colours.shade });
    const told = Object.entries(shown).map(([name, colour]) => {
      const box = document.createElement("span"), patch = document.createElement("i");
      patch.style.background = colour;
      box.append(patch, name);
      return box;
    });
    const more = document.createElement("span");
    more.textContent = `◆ start and end  ✕ hover${coverage ? "" : "  ◔ device and the data it has left; the path has the colour of the device served most"}`;
    find("legend").replaceChildren(...told, more);
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

  return { open, repaint, replayAll };
})();

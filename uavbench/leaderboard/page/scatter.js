"use strict";

// The scatter: CRAL of each agent against the time that it takes for a decision, as wide as there is room.
const Scatter = (() => {
  const find = (id) => document.getElementById(id);
  const LEFT = 44, RIGHT = 14, TOP = 26, BOTTOM = 46, POINT = 6, LINE = 15;
  let shown = [];

  function svg(name, attributes = {}, ...children) {
    const made = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    made.append(...children);
    return made;
  }

  // The lowest CRAL that the axis must reach. One agent far below all others is not worth most of the axis: where the widest gap
  // between neighbours is wider than all that is above it, those below it are drawn at the edge.
  function lowest(values) {
    const falling = [...values].sort((a, b) => b - a), gaps = falling.slice(1).map((value, k) => falling[k] - value);
    const widest = gaps.indexOf(Math.max(...gaps));
    return widest > 0 && gaps[widest] > falling[0] - falling[widest] ? falling[widest] : falling.at(-1);
  }

  function draw(rows = shown) {
    shown = rows;
    const section = find("scatter").closest("section");
    section.hidden = !rows.length;
    if (!rows.length) return;
    const width = find("scatter").clientWidth, height = width < 600 ? 320 : 380;
    const times = rows.map((row) => 1000 / row.decisions_per_second), values = rows.map((row) => row.cral[0]);
    const [x, ticks] = logarithmic(times, LEFT, width - RIGHT), least = lowest(values);
    const [y, marks] = linear(least, Math.max(...values), height - BOTTOM, TOP);
    const drawn = svg("svg", { width, height, viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": "CRAL of each agent against the time it takes for a decision" });
    find("scatter").replaceChildren(drawn);
    drawn.append(svg("line", { class: "axis", x1: LEFT, x2: width - RIGHT, y1: height - BOTTOM, y2: height - BOTTOM }));
    for (const tick of ticks) {
      drawn.append(svg("line", { class: "axis", x1: x(tick), x2: x(tick), y1: TOP, y2: height - BOTTOM }));
      drawn.append(svg("text", { class: "quiet", x: x(tick), y: height - BOTTOM + 17, "text-anchor": "middle" }, String(Number(tick.toPrecision(1)))));
    }
    for (const mark of marks) {
      drawn.append(svg("line", { class: "axis", x1: LEFT, x2: width - RIGHT, y1: y(mark), y2: y(mark) }));
      drawn.append(svg("text", { class: "quiet", x: LEFT - 7, y: y(mark) + 4, "text-anchor": "end" }, String(mark)));
    }
    drawn.append(svg("text", { class: "quiet", x: 10, y: 16 }, "CRAL, %"));
    drawn.append(svg("text", { class: "quiet", x: width - RIGHT, y: height - 8, "text-anchor": "end" }, "time for a decision, ms (logarithmic)"));
    const points = rows.map((row, k) => {
      const below = values[k] < least, at = [x(times[k]), below ? height - BOTTOM - POINT : y(values[k])];
      const label = below ? `${row.name} ${values[k].toFixed(1)}` : row.name;
      return { row, at, below, label, told: `${row.name}: ${values[k].toFixed(1)} %, ${times[k].toPrecision(2)} ms` };
    });
    drawn.append(svg("path", { class: "front", d: front(points.map(({ at }) => at), width - RIGHT) }));
    for (const { row, at: [a, b], below, told } of points) drawn.append(point(row.track, a, b, below, svg("title", {}, told)));
    find("below").hidden = !points.some((each) => each.below);
    label(drawn, points, width - RIGHT / 2, height - BOTTOM);
  }

  // The Pareto front: a line in steps over the agents that no other one beats in both, from the fastest one to the right edge.
  function front(points, right) {
    const best = [];
    for (const [x, y] of [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1])) if (!best.length || y < best.at(-1)[1]) best.push([x, y]);
    return best.map(([x, y], k) => (k ? `H${x}V${y}` : `M${x} ${y}`)).join("") + `H${right}`;
  }

  function point(track, x, y, below, title) {
    if (below) return svg("path", { class: `point ${track}`, d: `M${x - 6} ${y - 6}h12l-6 11z` }, title);
    if (track === "state") return svg("rect", { class: `point ${track}`, x: x - 4.5, y: y - 4.5, width: 9, height: 9 }, title);
    return svg("circle", { class: `point ${track}`, cx: x, cy: y, r: 5 }, title);
  }

  // Write names where they touch neither a point nor each other, the best agents' first; a line leads to a name that is far from its
  // point. A name for which there is no room is left out: the point says it when it is pointed at.
  function label(drawn, points, right, bottom) {
    const taken = points.map(({ at: [x, y] }) => [x - POINT, y - POINT, x + POINT, y + POINT]);
    for (const { row, at: [x, y], label: name } of [...points].sort((a, b) => b.row.cral[0] - a.row.cral[0])) {
      const text = svg("text", { class: "name", "data-name": row.name }, name);
      drawn.append(text);
      const wide = text.getComputedTextLength() + 4;
      const box = places(x, y, wide).find(([x0, y0, x1, y1]) => x0 >= LEFT && y0 >= TOP && x1 <= right && y1 <= bottom
        && taken.every(([a0, b0, a1, b1]) => x1 <= a0 || a1 <= x0 || y1 <= b0 || b1 <= y0));
      if (!box) {
        text.remove();
        continue;
      }
      const [x0, y0, x1, y1] = box;
      taken.push(box);
      text.setAttribute("x", x0 + 2);
      text.setAttribute("y", y1 - 4);
      const to = [Math.max(x0, Math.min(x, x1)), Math.max(y0, Math.min(y, y1))];
      if (Math.hypot(to[0] - x, to[1] - y) > 2 * POINT) text.before(svg("line", { class: "lead", x1: x, y1: y, x2: to[0], y2: to[1] }));
    }
  }

  // Boxes for a name beside, above and below its point, the near ones first.
  function places(x, y, wide) {
    return [POINT + 1, 16, 28, 42, 58, 76].flatMap((far) => {
      const beside = [y - LINE / 2, y - LINE / 2 - far, y - LINE / 2 + far];
      const across = [x - wide / 2, x - wide - far / 2, x + far / 2];
      const found = [
        ...beside.flatMap((top) => [[x + far, top], [x - far - wide, top]]),
        ...across.flatMap((left) => [[left, y - far - LINE], [left, y + far]]),
      ];
      return found.map(([left, top]) => [left, top, left + wide, top + LINE]);
    });
  }

  function linear(low, high, from, to) {
    const spare = Math.max(1, 0.1 * (high - low)), [bottom, top] = [low - spare, high + spare];
    const step = [1, 2, 5, 10, 20].find((each) => (top - bottom) / each <= 7) || 20;
    const marks = [];
    for (let mark = Math.ceil(bottom / step) * step; mark <= Math.min(100, top); mark += step) if (mark >= 0) marks.push(mark);
    return [(value) => from + ((value - bottom) / (top - bottom)) * (to - from), marks];
  }

  function logarithmic(times, from, to) {
    const found = times.map(Math.log10), spare = Math.max(0.3, 0.08 * (Math.max(...found) - Math.min(...found)));
    const low = Math.min(...found) - spare, high = Math.max(...found) + spare, ticks = [];
    for (let power = Math.floor(low); power <= high; power++) {
      for (const digit of high - low < 1.5 ? [1, 2, 5] : [1]) {
        const tick = digit * 10 ** power;
        if (Math.log10(tick) >= low && Math.log10(tick) <= high) ticks.push(tick);
      }
    }
    return [(time) => from + ((Math.log10(time) - low) / (high - low)) * (to - from), ticks];
  }

  let width = 0;
  new ResizeObserver(([{ contentRect }]) => {
    if (!contentRect.width || contentRect.width === width) return; // it is hidden, or its height was set here
    width = contentRect.width;
    draw();
  }).observe(find("scatter"));

  return { draw };
})();

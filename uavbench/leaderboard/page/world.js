"use strict";

// The rules of the world once more (docs/rules.md): a visitor's own machine replays what the table says. Constants and episodes
// come with the page; a test compares what comes out here with the submissions.
const World = (() => {
  const WORD = (1n << 64n) - 1n, GOLDEN = 0x9E3779B97F4A7C15n, NOISE = 3n;
  const MOVES = [[-1, 0], [0, 1], [1, 0], [0, -1], [0, 0], [0, 0]], HOVER = 4, LAND = 5, NONE = 255;
  const NEVER = 1e9, CELLS = ".LN#b"; // cells by their codes
  const TYPES = {
    uint8: Uint8Array, uint16: Uint16Array, int16: Int16Array, float32: Float32Array, float64: Float64Array, uint64: BigUint64Array,
  };

  // Arrays as they come with the page: deflated, in base64.
  async function unpack(packed) {
    const bytes = Uint8Array.from(atob(packed.data), (c) => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    return { values: new TYPES[packed.dtype](await new Response(stream).arrayBuffer()), shape: packed.shape };
  }

  async function unpackAll(table) {
    const names = Object.keys(table);
    const found = await Promise.all(names.map((name) => unpack(table[name])));
    return Object.fromEntries(names.map((name, k) => [name, found[k]]));
  }

  // Random numbers from keys, as uavbench/world/keyed.py.
  function mix(z) {
    z = ((z ^ (z >> 30n)) * 0xBF58476D1CE4E5B9n) & WORD;
    z = ((z ^ (z >> 27n)) * 0x94D049BB133111EBn) & WORD;
    return z ^ (z >> 31n);
  }
  const stream = (key, purpose) => mix((mix((key + GOLDEN) & WORD) + purpose * GOLDEN) & WORD);

  function ratio(terms, x) {
    let above = 0, below = 0;
    for (const [a, b] of terms) {
      above = above * x + a;
      below = below * x + b;
    }
    return above / below;
  }

  function normal(start, index, quantile) {
    const bits = mix((start + BigInt(index) * GOLDEN) & WORD);
    const p = (Number(bits >> 11n) + 0.5) * 2 ** -53, centred = p - 0.5;
    if (Math.abs(centred) <= 0.425) return centred * ratio(quantile.centre, 0.180625 - centred * centred);
    const tail = Math.sqrt(-Math.log(centred < 0 ? p : 1 - p));
    const size = tail <= 5 ? ratio(quantile.shoulder, tail - 1.6) : ratio(quantile.tail, tail - 5);
    return centred < 0 ? -size : size;
  }

  function roundHalfEven(x) {
    const low = Math.floor(x), rest = x - low;
    return rest > 0.5 || (rest === 0.5 && low % 2 === 1) ? low + 1 : low;
  }

  class City {
    constructor(rows) {
      this.rows = rows.length;
      this.cols = rows[0].length;
      this.cells = rows.join("");
      this.views = new Map();
    }
    at(r, c) { return this.cells[r * this.cols + c]; }
    inside(r, c) { return r >= 0 && r < this.rows && c >= 0 && c < this.cols; }
    building(r, c) { return this.at(r, c) === "#" || this.at(r, c) === "b"; }
    closed(r, c) { return !this.inside(r, c) || this.at(r, c) === "#" || this.at(r, c) === "N"; }

    // What rays from a cell to all border cells reach, at most so many moves away.
    visible(r, c, steps) {
      const name = `${r},${c},${steps}`;
      if (!this.views.has(name)) {
        const seen = new Uint8Array(this.rows * this.cols);
        seen[r * this.cols + c] = 1;
        for (let x = 0; x < this.cols; x++) {
          this.cast(r, c, 0, x, steps, seen);
          this.cast(r, c, this.rows - 1, x, steps, seen);
        }
        for (let y = 1; y < this.rows - 1; y++) {
          this.cast(r, c, y, 0, steps, seen);
          this.cast(r, c, y, this.cols - 1, steps, seen);
        }
        this.views.set(name, seen);
      }
      return this.views.get(name);
    }

    cast(r, c, r1, c1, steps, seen) {
      const dx = Math.abs(c - c1), dy = -Math.abs(r - r1), right = c1 > c ? 1 : -1, down = r1 > r ? 1 : -1;
      let error = dx + dy;
      for (let k = Math.min(dx - dy, steps); k > 0; k--) {
        if (2 * error - dy > dx - 2 * error) {
          error += dy;
          c += right;
        } else {
          error += dx;
          r += down;
        }
        if (this.building(r, c)) return;
        seen[r * this.cols + c] = 1;
      }
    }
  }

  // What the camera covers from a cell.
  function camera(scenario, r, c) {
    const { city, mission } = scenario, reach = (mission.camera_size - 1) / 2, seen = city.visible(r, c, 2 * reach), found = [];
    for (let y = r - reach; y <= r + reach; y++) {
      for (let x = c - reach; x <= c + reach; x++) {
        if (city.inside(y, x) && seen[y * city.cols + x] && !city.building(y, x)) found.push(y * city.cols + x);
      }
    }
    return found;
  }

  class Targets { // CPP
    constructor(scenario, episodes, number) {
      const { values, shape } = episodes.targets;
      this.scenario = scenario;
      this.coveredAt = new Int32Array(scenario.city.cells.length).fill(-1);
      for (let cell = 0; cell < this.coveredAt.length; cell++) {
        if ((values[number * shape[1] + (cell >> 3)] >> (7 - (cell & 7))) & 1) this.coveredAt[cell] = NEVER;
      }
      this.total = this.remaining = this.coveredAt.filter((time) => time === NEVER).length;
    }
    collect(uav, from, to, step, time) {
      let gain = 0;
      for (const cell of camera(this.scenario, ...to)) {
        if (this.coveredAt[cell] === NEVER) {
          this.coveredAt[cell] = time;
          gain++;
        }
      }
      this.remaining -= gain;
      return { gain };
    }
    snapshot() { return null; }
  }

  class Devices { // DH
    constructor(scenario, episodes, number) {
      const { device_count: count, device_cell: cell, device_data: data, key } = episodes, most = data.shape[1];
      this.scenario = scenario;
      this.fading = stream(key.values[number], NOISE);
      this.devices = Array.from({ length: count.values[number] }, (_, j) => {
        const k = number * most + j;
        return { cell: [cell.values[2 * k], cell.values[2 * k + 1]], data: data.values[k], left: data.values[k] };
      });
      this.total = this.remaining = this.devices.reduce((sum, device) => sum + device.data, 0);
    }
    collect(uav, from, to, step) {
      const { city, channel, quantile } = this.scenario, start = stream(this.fading, BigInt(step)), served = new Map();
      for (let k = 1; k <= channel.steps; k++) {
        const [r, c] = [0, 1].map((axis) => from[axis] + (k / channel.steps) * (to[axis] - from[axis]));
        const here = roundHalfEven(r) * city.cols + roundHalfEven(c);
        let best = -1, highest = -Infinity;
        this.devices.forEach((device, j) => {
          if (device.left <= 0) return;
          const [y, x] = device.cell, clear = city.visible(y, x, city.rows + city.cols)[here];
          const down = (y - r) * channel.cell_size, right = (x - c) * channel.cell_size;
          const square = down * down + right * right + channel.altitude * channel.altitude;
          const noise = normal(start, uav * 2 ** 32 + k * 2 ** 16 + j, quantile);
          const level = channel.log_gain - channel.half_exponent[clear] * Math.log(square) + channel.fading[clear] * noise;
          if (level > highest) [best, highest] = [j, level];
        });
        if (best < 0) break;
        const amount = Math.min(Math.log2(1 + Math.exp(highest)), this.devices[best].left);
        this.devices[best].left -= amount;
        served.set(best, (served.get(best) || 0) + amount);
      }
      this.remaining = this.devices.reduce((sum, device) => sum + device.left, 0);
      const [device] = [...served].sort((a, b) => b[1] - a[1])[0] || [-1];
      return { device };
    }
    snapshot() { return this.devices.map((device) => device.left); }
  }

  // Fly an episode; a frame for the start and one after every step.
  function fly(scenario, episodes, number, actions) {
    const uavs = episodes.uavs ? episodes.uavs.values[number] : 1, most = scenario.uavs;
    const each = (name, width) => Array.from({ length: uavs }, (_, u) => {
      const at = (number * most + u) * width;
      return Array.from(episodes[name].values.slice(at, at + width));
    });
    const team = each("start", 2).map((position, u) => ({
      position, initial: each("budget", 1)[u][0], budget: each("budget", 1)[u][0], landed: false, done: false,
    }));
    const mission = scenario.mission.kind === "coverage" ? new Targets(scenario, episodes, number) : new Devices(scenario, episodes, number);
    const frames = [];
    const frame = (events) => frames.push({
      team: team.map(({ position, budget, landed, done }) => ({ position: [...position], budget, landed, done })),
      remaining: mission.remaining, left: mission.snapshot(), events,
    });
    frame([]);
    for (let time = 0; time < actions.length / most; time++) {
      frame(team.map((uav, u) => {
        if (uav.done) return null;
        const action = actions[time * most + u], from = uav.position;
        const next = from.map((value, axis) => value + MOVES[action][axis]);
        const held = team.some((other) => !other.done && other !== uav && other.position.join() === next.join());
        if (action === LAND) uav.landed = scenario.city.at(...from) === "L";
        else if (action !== HOVER && !scenario.city.closed(...next) && !held) uav.position = next;
        uav.budget -= 1;
        uav.done = uav.landed || uav.budget === 0;
        const event = { action, from, to: uav.position };
        return uav.done ? event : { ...event, ...mission.collect(u, from, uav.position, uav.initial - uav.budget, time + 1) };
      }));
    }
    const cr = (mission.total - mission.remaining) / mission.total;
    return { frames, mission, total: mission.total, cr, landed: team.every((uav) => uav.landed), budgets: team.map((uav) => uav.initial) };
  }

  // The city of each test episode of a scenario: the only one, or one of many, which are stored as codes of cells.
  async function citiesOf({ rows, cities }) {
    if (!cities) {
      const only = new City(rows);
      return () => only;
    }
    const { values, shape: [count, high, wide] } = await unpack(cities), made = new Map();
    return (episode) => {
      const city = episode % count;
      if (!made.has(city)) {
        const line = (r) => Array.from(values.subarray((city * high + r) * wide, (city * high + r + 1) * wide), (code) => CELLS[code]).join("");
        made.set(city, new City(Array.from({ length: high }, (_, r) => line(r))));
      }
      return made.get(city);
    };
  }

  return { City, camera, citiesOf, fly, unpackAll, LAND, HOVER, NONE, NEVER };
})();

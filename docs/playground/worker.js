// A worker with an instance of the library. It answers calls in order.

import init, { City, check, modes } from "./logicity_playground.js";

const ready = init();
let city;
let panic = "";

/** The library calls this when it panics. */
globalThis.reportPanic = (message) => {
  panic = message;
};

const calls = {
  modes: () => JSON.parse(modes()),
  check: (mode, rules) => JSON.parse(check(mode, rules)),
  /** Begins a run. */
  begin(mode, rules, seed) {
    const next = new City(mode, rules, BigInt(seed));
    city?.free();
    city = next;
    return { header: JSON.parse(city.header()), scenery: JSON.parse(city.scenery()) };
  },
  /** Continues the run under other rules. */
  change(rules, tick) {
    city.change(rules, tick);
    return { header: JSON.parse(city.header()) };
  },
  /** Runs ticks. A report is why there are fewer than `count`. */
  ticks(count, agent) {
    const ticks = [];
    try {
      while (ticks.length < count) {
        const tick = JSON.parse(city.tick());
        ticks.push({ tick, explanation: agent < 0 ? null : explain(tick.tick, agent) });
      }
    } catch (error) {
      if (typeof error !== "string") throw error;
      return { ticks, report: JSON.parse(error) };
    }
    return { ticks };
  },
  /** Explains what an agent did in some ticks. */
  explain: (ticks, agent) => ticks.map((tick) => explain(tick, agent)),
};

/** Returns an explanation; `null` for an unknown tick. One that takes too many steps is empty and has `isCut`. */
function explain(tick, agent) {
  try {
    return JSON.parse(city.explain(tick, agent));
  } catch (error) {
    if (typeof error !== "string") throw error;
    return { tick, agent, why: [-1, -1, -1, -1], nodes: [], rows: [], isCut: true };
  }
}

onmessage = async ({ data: { id, call, args } }) => {
  try {
    await ready;
    postMessage({ id, result: calls[call](...args) });
  } catch (error) {
    // The library throws reports of diagnostics as text; everything else is a defect.
    if (typeof error === "string") postMessage({ id, report: JSON.parse(error) });
    else postMessage({ id, fault: panic || String(error?.message ?? error) });
  }
};

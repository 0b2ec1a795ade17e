// The summary of a run: its clauses, deadlocks, and driven agents.

class Summary {
  constructor(run, page) {
    Object.assign(this, { run, page, data: run.data, now: page.now });
    this.fill();
  }

  fill() {
    const { data } = this;
    $("title").textContent = data.title;
    $("about").textContent =
      `${data.agents.length} agents on ${data.map.name}, ${this.run.count} ticks, rules ${data.rules} (${data.hash.slice(0, 12)})`;
    $("scrub").max = this.run.count - 1;
    for (const speed of SPEEDS) $("speed").append(make("option", { value: speed, selected: speed === this.now.speed }, `${speed} /s`));
    for (const action of data.actions) {
      $("legend").append(make("li", {}, make("span", { class: "swatch", style: `background:${COLORS[action]}` }), action));
    }
    for (let clause = 0; clause < data.counted; clause += 1) {
      const { head, doc, text } = data.clauses[clause];
      const title = (doc || text).split("\n")[0];
      const [count, decides] = data.firings[clause];
      const choose = decides ? () => this.page.choose({ clause: this.now.clause === clause ? -1 : clause }) : undefined;
      const row = make("tr", { "data-clause": clause, "data-decides": decides },
        make("td", {}, String(count)),
        make("td", {}, make("span", { class: "swatch", style: `background:${COLORS[head] ?? "var(--faint)"}` }), head),
        make("td", {}, decides ? make("button", { type: "button", title: "show all firings" }, title) : title));
      if (decides) row.addEventListener("click", choose);
      $("clauses").append(row);
    }
    this.fillDeadlocks();
    this.fillDriven();
  }

  fillDeadlocks() {
    const { data } = this;
    for (const found of data.deadlocks) {
      const names = found.agents.map((agent) => data.agents[agent].id);
      const by = (clause) => (clause === null ? "" : ` (${this.run.label(clause)})`);
      const chain = names.map((name, at) => name + by(found.clauses[at])).join(" → ");
      const since = found.since === data.first && data.first > 0 ? `${found.since} or before` : found.since;
      const lasts = found.until + 10 > data.first + this.run.count;
      const when = lasts ? `deadlock since tick ${since}` : `wait cycle, ticks ${since} to ${found.until}`;
      const go = () => this.page.choose({ tick: Math.min(Math.max(found.since - data.first, 0), this.run.count - 1), agent: found.agents[0] });
      $("deadlocks").append(make("button", { type: "button", onclick: go, title: "go to this tick" },
        `${when}: ${chain} → ${names[0]}`));
    }
    if (!data.deadlocks.length) $("deadlocks").append("no deadlock");
    if (data.deadlock_searches_cut) $("deadlocks").append(` (${data.deadlock_searches_cut} deadlock searches reached their limit)`);
  }

  /** Lists driven agents, and their decisions that violated a clause. */
  fillDriven() {
    const { data } = this;
    if (!data.driven) return;
    $("driven").hidden = false;
    $("legend").append(make("li", {}, make("span", { class: "swatch driven" }), "driven"));
    for (const [agent, steps] of Map.groupBy(data.driven, (step) => step.agent)) {
      const heeded = steps.filter(({ tick, wanted }) => data.ticks[tick].action[agent] === wanted).length;
      const go = (tick) => () => this.page.choose({ tick, agent });
      const broken = steps.filter((step) => step.broken.length).map(({ tick, broken }) => {
        const labels = broken.map((clause) => this.run.label(clause)).join(", ");
        return make("button", { type: "button", title: "go to this tick", onclick: go(tick) }, `tick ${data.first + tick}: violated ${labels}`);
      });
      $("driven").append(
        make("button", { type: "button", title: "go to this tick", class: "agent-link", onclick: go(steps[0].tick) }, data.agents[agent].id),
        ` was driven: ${heeded} of ${steps.length} actions agreed with the rules. `,
        ...(broken.length ? broken : ["No clause was violated."]));
    }
  }

  fillFilter() {
    const { clause, tick, agent } = this.now;
    $("filter").hidden = clause < 0;
    if (clause < 0) return;
    const { label, file, line, text } = this.data.clauses[clause];
    const all = this.run.firings[clause];
    const at = all.findIndex(([t, a]) => t === tick && a === agent);
    const place = at < 0 ? "" : `${at + 1} of `;
    $("filter").replaceChildren(
      make("div", { class: "card-head" },
        make("strong", {}, label),
        make("span", {}, `fired ${place}${all.length} times`),
        make("button", { type: "button", title: "previous (,)", onclick: () => this.page.jump(-1) }, "◀"),
        make("button", { type: "button", title: "next (.)", onclick: () => this.page.jump(1) }, "▶"),
        make("button", { type: "button", onclick: () => this.page.choose({ clause: -1 }) }, "all clauses")),
      make("pre", {}, text),
      make("div", { class: "clause" }, `${file}:${line}`));
  }
}

// The summary of a run: its clauses, deadlocks, and driven agents.

class Summary {
  constructor(run, page, number) {
    Object.assign(this, { run, page, number, data: run.data, now: page.now });
    this.fillClauses();
    this.fillDeadlocks();
    this.fillDriven();
  }

  /** Returns an element of the pane of this run. */
  element(name) {
    return $(paneId(name, this.number));
  }

  /** Returns the name of the run in front of a text, if there are two. */
  named(text) {
    return this.page.difference ? `${this.page.difference.names[this.number]}: ${text}` : text;
  }

  fillClauses() {
    const { data } = this;
    if (this.page.difference)
      this.element("clauses-title").textContent = this.named(`clauses of ${fileName(data.rules)}`);
    if (data.learned) {
      const [first, ...notes] = data.learned.notes;
      const all = make("details", {}, make("summary", {}, `Learned from ${first}`), make("ul", { class: "notes" }));
      all.lastChild.append(...notes.map((note) => make("li", {}, note)));
      this.element("filter").before(all);
    }
    for (let clause = 0; clause < data.counted; clause += 1) {
      const { head, doc, text, label } = data.clauses[clause];
      const title = doc ? this.run.title(clause) : text.split("\n")[0];
      const [all, decides] = data.firings[clause];
      // Beside a shorter run, firings in later ticks do not count.
      const count = decides && this.run.count < data.count ? this.run.firingsOf(clause).length : all;
      const choose = decides
        ? () => this.page.choose({ clause: this.isChosen(clause) ? -1 : clause, of: this.number })
        : undefined;
      const row = make(
        "tr",
        { "data-clause": clause, "data-decides": decides },
        make("td", {}, String(count)),
        make(
          "td",
          { title: head },
          make("span", { class: "swatch", style: `background:${COLORS[head] ?? "var(--faint)"}` }),
          head,
        ),
        make(
          "td",
          {},
          decides ? make("button", { type: "button", title: "show all firings" }, title) : title,
          this.coverage(label),
        ),
      );
      if (decides) row.addEventListener("click", choose);
      this.element("clauses").append(row);
    }
  }

  /** Returns a bar for the share of the examples of its action that a learned clause explains, alone and with others. */
  coverage(label) {
    const support = this.run.support.get(label);
    if (!support) return null;
    const { examples } = this.data.learned.actions.find(({ action }) => action === support.action);
    const part = (count, name) => make("span", { class: name, style: `width:${(100 * count) / Math.max(examples, 1)}%` });
    const color = COLORS[support.action] ?? "var(--faint)";
    return make(
      "span",
      { class: "coverage", title: this.explains(support), style: `color:${color}` },
      part(support.alone, "alone"),
      part(support.examples - support.alone, "shared"),
    );
  }

  /** Returns how many examples a learned clause explains. */
  explains({ action, examples, alone }) {
    const all = this.data.learned.actions.find((rules) => rules.action === action).examples;
    return `explains ${examples} of ${all} examples of ${action}, ${alone} alone`;
  }

  /** Returns what the examples say about a learned clause. */
  supportOf(label) {
    const support = this.run.support.get(label);
    if (!support) return [];
    const first = support.first ? `; the first of these is ${support.first}` : "";
    return [
      make("div", { class: "explains" }, this.explains(support) + first),
      make("ul", { class: "notes" }, ...support.notes.map((note) => make("li", {}, note))),
    ];
  }

  isChosen(clause) {
    return this.now.clause === clause && this.now.of === this.number;
  }

  fillDeadlocks() {
    const { data, run } = this;
    const list = $("deadlocks");
    const shown = data.deadlocks.filter(({ since }) => since < data.first + run.count);
    for (const found of shown) {
      const names = found.agents.map((agent) => data.agents[agent].id);
      const by = (clause) => (clause === null ? "" : ` (${run.label(clause)})`);
      const chain = names.map((name, at) => name + by(found.clauses[at])).join(" → ");
      const since = found.since === data.first && data.first > 0 ? `${found.since} or before` : found.since;
      const lasts = found.until + 10 > data.first + run.count;
      const when = lasts ? `deadlock since tick ${since}` : `wait cycle, ticks ${since} to ${found.until}`;
      const go = () =>
        this.page.choose({
          tick: Math.min(Math.max(found.since - data.first, 0), run.count - 1),
          agent: found.agents[0],
        });
      list.append(
        make(
          "button",
          { type: "button", onclick: go, title: "go to this tick" },
          this.named(`${when}: ${chain} → ${names[0]}`),
        ),
      );
    }
    if (!shown.length) list.append(make("span", {}, `${this.named("no deadlock")} `));
    if (data.deadlock_searches_cut)
      list.append(` (${data.deadlock_searches_cut} deadlock searches reached their limit)`);
  }

  /** Lists driven agents, and their decisions that violated a clause. */
  fillDriven() {
    const { data, run } = this;
    const driven = data.driven?.filter(({ tick }) => tick < run.count);
    if (!driven?.length) return;
    $("driven").hidden = false;
    for (const [agent, steps] of Map.groupBy(driven, (step) => step.agent)) {
      const heeded = steps.filter(({ tick, wanted }) => run.act(tick, agent) === wanted).length;
      const go = (tick) => () => this.page.choose({ tick, agent });
      const broken = steps
        .filter((step) => step.broken.length)
        .map(({ tick, broken }) => {
          const labels = broken.map((clause) => run.label(clause)).join(", ");
          return make(
            "button",
            { type: "button", title: "go to this tick", onclick: go(tick) },
            `tick ${data.first + tick}: violated ${labels}`,
          );
        });
      $("driven").append(
        make(
          "div",
          {},
          this.named(""),
          make(
            "button",
            { type: "button", title: "go to this tick", class: "agent-link", onclick: go(steps[0].tick) },
            data.agents[agent].id,
          ),
          ` was driven: ${heeded} of ${steps.length} actions agreed with the rules. `,
          ...(broken.length ? broken : ["No clause was violated."]),
        ),
      );
    }
  }

  /** Scrolls the list to the clause that decides for the chosen agent. */
  showDeciding() {
    const row = this.element("clauses").querySelector("[data-deciding]");
    const box = this.element("clause-box");
    if (!row || this.now.playing || box.scrollHeight <= box.clientHeight) return;
    const top = row.getBoundingClientRect().top - box.getBoundingClientRect().top;
    if (top < 0 || top + row.offsetHeight > box.clientHeight) box.scrollTop += top - box.clientHeight / 3;
  }

  /** Shows the chosen clause and its firings. */
  fillFilter() {
    const { clause, tick, agent } = this.now;
    const filter = this.element("filter");
    const deciding = agent < 0 ? [] : this.run.fired(tick, agent);
    for (const row of this.element("clauses").rows) {
      row.setAttribute("aria-selected", this.isChosen(Number(row.dataset.clause)));
      row.toggleAttribute("data-deciding", deciding.includes(Number(row.dataset.clause)));
    }
    filter.hidden = !this.isChosen(clause) || clause < 0;
    if (filter.hidden) {
      this.showDeciding();
      return;
    }
    const { label, file, line, text } = this.data.clauses[clause];
    const all = this.run.firingsOf(clause);
    const at = all.findIndex(([t, a]) => t === tick && a === agent);
    const place = at < 0 ? "" : `${at + 1} of `;
    filter.replaceChildren(
      make(
        "div",
        { class: "card-head" },
        make("strong", {}, label),
        make("span", {}, `fired ${place}${all.length} times`),
        make(
          "button",
          { type: "button", title: "previous (,)", "aria-label": "previous firing", onclick: () => this.page.jump(-1) },
          "◀\uFE0E",
        ),
        make(
          "button",
          { type: "button", title: "next (.)", "aria-label": "next firing", onclick: () => this.page.jump(1) },
          "▶\uFE0E",
        ),
        make("button", { type: "button", onclick: () => this.page.choose({ clause: -1 }) }, "all clauses"),
      ),
      make("pre", {}, text),
      ...this.supportOf(label),
      make("div", { class: "clause" }, `${file}:${line}`),
    );
  }
}

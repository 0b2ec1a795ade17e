// The panel of the chosen agent: its action and the explanation.

/** Returns a value with at most two decimal places. */
function decimal(value) {
  return typeof value === "number" ? String(Math.round(100 * value) / 100) : value;
}

class AgentPanel {
  constructor(run, page, number) {
    Object.assign(this, { run, page, number, data: run.data, now: page.now });
    this.panel = $(paneId("agent", number));
  }

  id(name) {
    return paneId(name, this.number);
  }

  fill() {
    const {
      data,
      panel,
      run,
      now: { tick, agent },
    } = this;
    // A click must begin and end on the same element.
    if (this.now.playing && panel.matches(":active")) return;
    // Parts that the reader opened stay open from tick to tick.
    const open = new Set([...panel.querySelectorAll("details[open]")].map((details) => details.dataset.part));
    if (agent < 0) {
      panel.replaceChildren(...this.overview(tick).filter((part) => part));
      return;
    }
    const { id, kind, concepts, priority } = data.agents[agent];
    const done = run.action(tick, agent);
    const driven = run.driven(tick, agent);
    const judged = run.byRules(tick, agent);
    const derived = run.derived(tick, agent);
    const parts = [
      this.runName(),
      make(
        "div",
        { class: "card-head" },
        make("h2", {}, id),
        this.badge(done, this.id("action")),
        ...[kind, ...concepts].map((word) => make("span", { class: "chip" }, word)),
        driven && make("span", { class: "chip driven" }, "driven"),
        make(
          "button",
          {
            type: "button",
            class: "close",
            title: "clear the selection (Esc)",
            "aria-label": "clear the selection",
            onclick: () => this.page.choose({ agent: -1 }),
          },
          "×",
        ),
      ),
    ];
    if (driven) parts.push(make("dl", { class: "facts" }, ...this.steering(driven)));
    const isWrong = !driven && data.actions[judged] !== done;
    const wanted = data.actions[judged];
    if (isWrong)
      parts.push(make("p", { class: "no" }, `The example has ${done}, but the learned rules choose ${wanted}.`));
    parts.push(make("h3", {}, driven || isWrong ? `Why do the rules want ${wanted}?` : `Why ${done}?`));
    if (!run.isExplained(tick, agent)) {
      parts.push(make("p", { class: "atoms" }, "loading the explanations …"));
    } else {
      if (!driven && !run.fired(tick, agent).length)
        parts.push(make("p", { class: "atoms" }, "No clause fired, so the default applies."));
      parts.push(this.tree(run.node(tick, agent, judged)));
      data.actions.forEach((other, index) => {
        const node = run.node(tick, agent, index);
        if (index === judged || node < 0) return;
        const question = derived.includes(other) ? `${other} was derived too: why?` : `Why not ${other}?`;
        parts.push(this.part(`why-${other}`, question, open, () => [this.tree(node)]));
      });
      parts.push(this.part("atoms", "True atoms", open, () => this.atoms(tick, agent)));
    }
    parts.push(this.state(tick, agent, derived, data.actions[judged], priority));
    panel.replaceChildren(...parts.filter((part) => part));
  }

  /** Returns the name of the run, if there are two. */
  runName() {
    const { difference } = this.page;
    return difference
      ? make("p", { class: "panel-run" }, `${difference.names[this.number]}: ${fileName(this.data.rules)}`)
      : null;
  }

  badge(action, id) {
    return make("span", { class: "badge", id, style: `background:${COLORS[action]}` }, action);
  }

  /** Returns the lists of the agents that match the filter, by kind; those that differ between two runs come first. */
  overview(tick) {
    const { data, run } = this;
    const different = new Set(this.page.difference?.at(tick)?.acts);
    const item = (agent) =>
      make(
        "li",
        { class: different.has(agent) ? "different" : null },
        make("span", { class: "swatch", style: `background:${COLORS[run.action(tick, agent)]}` }),
        this.agentLink(agent),
        ` ${run.action(tick, agent)}`,
      );
    const { roster } = this.page;
    const groups = roster.groups(tick).flatMap((group) => {
      const order = group.agents.toSorted((a, b) => different.has(b) - different.has(a));
      return [
        make("h3", {}, `${group.name} (${roster.count(group)})`),
        make("ul", { class: "agents" }, ...order.map(item)),
      ];
    });
    const title = make("h2", {}, "Click an agent to see why it acts as it does");
    return [this.runName() ?? title, this.foundAgents(tick), ...groups];
  }

  /** Returns how many agents match the filter, if there is one, with a button that clears it. */
  foundAgents(tick) {
    const { roster, finder } = this.page;
    if (!roster.isFiltered) return null;
    const words = `${roster.agents(tick).length} of ${this.run.agents} agents match the filter. `;
    const clear = make("button", { type: "button", onclick: () => finder.clear() }, "show all");
    return make("p", { class: "found" }, words, clear);
  }

  /** Returns place, goal, priority and cause. */
  state(tick, agent, derived, preferred, priority) {
    const { run } = this;
    const heading = run.heading(tick, agent);
    const facts = make(
      "dl",
      { class: "facts" },
      make("dt", {}, "at"),
      make("dd", {}, `[${run.at(tick, agent).join(", ")}], ${heading ? `heading ${heading}` : "has not moved yet"}`),
      make("dt", {}, "goal"),
      make("dd", {}, `[${run.goal(tick, agent).join(", ")}]`),
      make("dt", {}, "priority"),
      make("dd", {}, String(priority)),
    );
    facts.append(...this.quantities(tick, agent));
    if (!run.driven(tick, agent))
      facts.append(make("dt", {}, "because"), make("dd", {}, run.causes(tick, agent) || "no clause fired"));
    if (derived.length > 1)
      facts.append(make("dt", {}, "derived"), make("dd", {}, `${derived.join(", ")}; the rules prefer ${preferred}`));
    return facts;
  }

  /** Returns the values of the quantities that the rules can read of an agent. */
  quantities(tick, agent) {
    if (!this.run.isExplained(tick, agent)) return [];
    const { predicates } = this.data;
    const read = Map.groupBy(this.run.quantities(tick, agent), ([name]) => name);
    const declared = predicates.filter(({ quantity }) => quantity);
    return declared.flatMap(({ name }) => {
      const shown = (read.get(name) ?? []).flatMap(([, value, other], at) => [
        at ? ", " : "",
        other === undefined ? "" : this.agentLink(other),
        other === undefined ? "" : " ",
        decimal(value),
      ]);
      return [make("dt", {}, name), make("dd", { class: "quantity" }, ...(shown.length ? shown : ["no value"]))];
    });
  }

  /** Shows what a driven agent observed, and the clauses that its action violated. Proofs cover all agents in view. */
  steering({ observes, wanted, broken, agent, tick }) {
    const { data } = this;
    const others = observes.filter((other) => other !== agent).flatMap((other) => [this.agentLink(other), " "]);
    const node = this.run.nodes[this.run.node(tick, agent, wanted)];
    const judged = broken.map((clause) => make("div", { class: "no" }, "violated ", this.clauseLink(clause)));
    return [
      make("dt", {}, "observes"),
      make("dd", {}, ...(others.length ? others : ["no other agent"])),
      make("dt", {}, "rules want"),
      make(
        "dd",
        { id: this.id("wanted") },
        data.actions[wanted],
        node && node.t === undefined ? "; given all agents in view, the rules want another action" : "",
      ),
      make("dt", {}, "judged"),
      make("dd", { id: this.id("judged") }, ...(judged.length ? judged : ["no clause violated"])),
    ];
  }

  /** Returns a section whose content is created when the reader opens it. */
  part(name, title, open, content) {
    const details = make("details", { "data-part": name, open: open.has(name) }, make("summary", {}, title));
    const fill = () => {
      if (details.open && details.childElementCount === 1) details.append(...content());
    };
    details.addEventListener("toggle", fill);
    fill();
    return details;
  }

  agentLink(agent, text = this.data.agents[agent].id) {
    const link = make(
      "button",
      { type: "button", class: "agent-link", onclick: () => this.page.choose({ agent }) },
      text,
    );
    const hover = (which) => () => {
      this.now.hover = which;
      this.page.draw();
    };
    for (const [name, which] of [
      ["mouseenter", agent],
      ["focus", agent],
      ["mouseleave", -1],
      ["blur", -1],
    ])
      link.addEventListener(name, hover(which));
    return link;
  }

  /** Returns a text in which agent names are links. */
  linked(text) {
    return text
      .split(/([\w.-]+)/)
      .map((word) =>
        this.run.names.has(word) && this.run.names.get(word) !== this.now.agent
          ? this.agentLink(this.run.names.get(word))
          : word,
      );
  }

  clauseLink(clause) {
    const { doc, file, line, text } = this.data.clauses[clause];
    const name = doc ? this.run.title(clause) : text.split("\n")[0];
    const shown = `${name}  [${fileName(file)}:${line}]`;
    // The page of a running city lists no clauses.
    if (!this.data.firings?.[clause]?.[1]) return make("span", { class: "clause", title: text }, shown);
    const onclick = (event) => {
      event.preventDefault();
      this.page.choose({ clause, of: this.number });
    };
    const href = `#${new URLSearchParams({ clause: this.run.label(clause) })}`;
    return make("a", { href, class: "clause", title: "show all firings", onclick }, shown);
  }

  /** Returns the proof of a node, or why it does not hold. Expands each node only once. */
  tree(number) {
    const list = make("ul", { class: "tree" });
    if (number >= 0) list.append(this.branch(number, this.run.nodes[number].t ?? this.run.nodes[number].f, new Set()));
    return list;
  }

  branch(number, text, expanded) {
    const node = this.run.nodes[number];
    const item = make("li", {});
    if (node.t !== undefined) {
      // In the present tick, the fact of a temporal operator is its operand: show it once.
      const [same] = node.p?.length === 1 && node.p[0][0] === text && node.p[0][2] >= 0 ? node.p : [];
      if (same) return this.branch(same[2], text, expanded);
      item.append(make("span", { class: "yes" }, ...this.linked(text)));
      if (node.w) item.append(`  ${node.w}`);
      if (node.c === undefined) return item;
      item.append(" by ", this.clauseLink(node.c));
      // A fact in the rule file has a clause but no premises.
      if (!node.p || expanded.has(number)) return item;
      expanded.add(number);
      item.append(make("ul", {}, ...node.p.map((premise) => this.premise(premise, expanded))));
      return item;
    }
    item.append(make("span", { class: "no" }, ...this.linked(text)));
    if (node.by === "not-looked-into") item.append(" (not explained further)");
    if (!node.m || expanded.has(number)) return item;
    expanded.add(number);
    item.append(this.misses(node.m, expanded));
    return item;
  }

  /** Returns a literal that holds. */
  premise([text, kind, child], expanded) {
    if (child < 0) return make("li", {}, make("span", { class: "yes" }, ...this.linked(text)));
    const node = this.run.nodes[child];
    if (kind !== "not") return this.branch(child, text, expanded);
    const item = make("li", {}, make("span", { class: "yes" }, ...this.linked(text)));
    if (node.m && !expanded.has(child)) {
      expanded.add(child);
      item.append(make("details", {}, make("summary", {}, "no clause derives it"), this.misses(node.m, expanded)));
    }
    return item;
  }

  /** Returns for each clause the literals that fail. */
  misses(misses, expanded) {
    return make(
      "ul",
      {},
      ...misses.map(([clause, binding, fails]) => {
        const nearest = Object.entries(binding).filter(([, name]) => this.run.names.get(name) !== this.now.agent);
        const item = make("li", {}, this.clauseLink(clause));
        if (nearest.length)
          item.append(
            " nearest ",
            ...this.linked(nearest.map(([variable, name]) => `${variable} = ${name}`).join(", ")),
          );
        const failures = fails.map(([text, kind, child]) => {
          const say =
            kind === "not"
              ? " fails"
              : kind === "in-view"
                ? " is not in view"
                : kind === "fact"
                  ? " does not hold"
                  : " is false";
          const failure = make("li", {}, make("span", { class: "no" }, ...this.linked(text)), say);
          const node = child < 0 ? undefined : this.run.nodes[child];
          if (node?.w) failure.append(`  ${node.w}`);
          if (node && (node.c !== undefined || node.m) && !expanded.has(child))
            failure.append(make("ul", {}, this.branch(child, node.t ?? node.f, expanded)));
          return failure;
        });
        if (!fails.length) failures.push(make("li", {}, "its head does not match"));
        item.append(make("ul", {}, ...failures));
        return item;
      }),
    );
  }

  /** Returns the atoms that are true of an agent and of the agents it sees, as the rules read them. */
  atoms(tick, agent) {
    const { predicates, agents } = this.data;
    const rows = this.run.rows(tick);
    const pair = (number) => [Math.floor(number / agents.length), number % agents.length];
    const seen = new Set([agent]);
    for (const number of rows[predicates.findIndex(({ name }) => name === "Sees")]) {
      const [from, to] = pair(number);
      if (from === agent) seen.add(to);
    }
    const of = new Map([...seen].sort((a, b) => (b === agent) - (a === agent) || a - b).map((one) => [one, []]));
    predicates.forEach(({ name, arity }, predicate) => {
      for (const number of [...rows[predicate]].sort((a, b) => a - b)) {
        const row = arity === 2 ? pair(number) : [number];
        if (row.some((one) => !seen.has(one)) || (arity === 2 && row[0] === row[1])) continue;
        of.get(row[0]).push(`${name}(${row.map((one) => agents[one].id).join(", ")})`);
      }
    });
    for (const one of seen) {
      for (const [name, value, other] of this.run.quantities(tick, one)) {
        if (other !== undefined && !seen.has(other)) continue;
        const names = [one, other].filter((who) => who !== undefined).map((who) => agents[who].id);
        const isOfCity = predicates.some((predicate) => predicate.name === name && predicate.arity === 0);
        if (isOfCity && one !== agent) continue;
        of.get(one).push(`${name}(${[...(isOfCity ? [] : names), decimal(value)].join(", ")})`);
      }
    }
    return [...of].map(([one, atoms]) =>
      make("div", {}, this.agentLink(one), make("p", { class: "atoms" }, ...this.linked(atoms.join(", ")))),
    );
  }
}

// Results of a test: the verdict of each case, and its replay over the map.

const $ = (id) => document.getElementById(id);
const WORDS = { pass: "passed", fail: "failed", error: "error", invalid: "invalid world" };

export class Results {
  constructor(run) {
    this.run = run;
    this.shown = "";
    $("close_results").addEventListener("click", () => { $("results").hidden = true; });
    $("close_replay").addEventListener("click", () => this.replay(null));
  }

  show(tests) {
    const text = JSON.stringify(tests);
    if (text === this.shown) return;
    this.shown = text;
    $("results").hidden = !tests.name;
    const cases = tests.cases || [], going = tests.name && tests.code === null;
    const passed = cases.filter((one) => one.verdict === "pass").length;
    $("verdict").textContent = `${tests.name || ""}: ${going ? "running …" : cases.length ? `${passed} of ${cases.length} passed` : "no result"}`;
    $("verdict").className = `pill${going ? " open" : tests.code === 0 ? "" : " bad"}`;
    $("test").textContent = going ? "Stop" : "Run test";
    $("cases").replaceChildren(...cases.map((one) => this.row(one, going)));
    // Without results the output states why.
    $("output").textContent = cases.length && tests.code !== 2 ? "" : (tests.lines || []).join("\n");
  }

  row(one, going) {
    const item = document.createElement("li"), head = document.createElement("div"), button = document.createElement("button");
    item.className = one.verdict;
    head.textContent = one.name;
    button.textContent = one.recorded ? "Replay" : "Run alone";
    button.title = one.recorded ? "the run in 3D over the map" : "run this case again and record it";
    button.disabled = going && !one.recorded;
    button.addEventListener("click", () => (one.recorded ? this.replay(one.name) : this.run(one.name)));
    head.append(button);
    const note = document.createElement("small");
    note.textContent = [WORDS[one.verdict], one.margin && `margin ${one.margin}`, one.reason, one.values].filter(Boolean).join(" · ");
    item.append(head, note);
    return item;
  }

  replay(name) {
    const frame = $("recording");
    $("replay").hidden = !name;
    $("replay_name").textContent = name ? `Replay of ${name}` : "";
    if (name) frame.src = `replay/${encodeURIComponent(name)}`;
    else frame.removeAttribute("src");
  }
}

// The page of the world editor: shows the state of the server and sends gestures to it.

import { send, latest } from "./server.js";
import { WorldMap } from "./map.js";
import { Gestures } from "./gestures.js";
import { show_palette } from "./palette.js";
import { Results } from "./results.js";

const $ = (id) => document.getElementById(id);
const POLL = 700; // ms between questions for changes outside and for the check
const TYPING = 600; // ms without a key after which a typed text is sent

const map = new WorldMap($("map"));
const options = { snap: () => $("snap").checked };
let dragged = null; // overlaps while something is dragged
let state = {}, typed = null, note_timer = null, pending = 0, groups = null;

// --- notes ---

function note(text, bad = false, actions = []) {
  clearTimeout(note_timer);
  const words = document.createElement("p"), row = document.createElement("div");
  // The name of the file is enough; its folder is above the map.
  words.textContent = state.file ? text.replaceAll(state.file, file_name()) : text;
  $("note").className = bad ? "bad" : "";
  for (const [label, run] of actions) {
    const button = document.createElement("button");
    button.textContent = label;
    button.addEventListener("click", () => { $("note").hidden = true; run(); });
    row.append(button);
  }
  $("note").replaceChildren(words, ...(actions.length ? [row] : []));
  $("note").hidden = !text;
  if (text && !actions.length) note_timer = setTimeout(() => { $("note").hidden = true; }, 6000);
}

const file_name = () => state.file.split("/").pop();

// --- state ---

async function ask(name, message = {}) {
  pending += 1;
  try {
    const reply = await send(name, message);
    if (reply.error) {
      note(reply.error, true);
      map.settle();
      dragged = null;
      map.show_marks(state.marks || []);
    } else take(reply);
    return reply;
  } catch (error) {
    note("The editor does not answer. Is `mirdrake world edit` still running?", true, []);
    return { error: String(error) };
  } finally {
    pending -= 1;
  }
}

function take(reply) {
  const before = state.revision;
  state = { ...state, ...reply };
  if (reply.scene) {
    dragged = null;
    map.show(reply.scene);
    map.show_marks(reply.marks);
    show_fields();
  }
  // The browser's text has line feeds only; the server keeps the line ends of the file.
  if (reply.text !== undefined && typed === null && $("yaml").value !== reply.text.replace(/\r\n?/g, "\n")) show_text(reply.text);
  if (reply.groups && String(reply.groups) !== groups) fill_palette(reply.groups);
  if (before !== state.revision && $("ghosts").checked) show_ghosts();
  if (reply.scene && before !== state.revision) show_solid();
  show_status();
  show_faults();
  document.body.dataset.revision = state.revision;
}

function show_status() {
  $("file").textContent = file_name();
  $("file").title = state.file;
  const saved = $("saved");
  saved.textContent = state.read_only ? "read only" : state.saved ? "saved" : "not saved";
  saved.title = state.read_only || "";
  saved.className = `pill${state.read_only ? " bad" : state.saved ? "" : " open"}`;
  $("undo").disabled = !state.undo;
  $("redo").disabled = !state.redo;
  $("save").disabled = state.saved || Boolean(state.read_only);
  $("copy").disabled = $("delete").disabled = !map.chosen.size;
  document.title = `${state.saved ? "" : "• "}${state.file} – world editor`;
  const names = (state.test_names || []).join("\n");
  if ($("case").dataset.names !== names) {
    $("case").dataset.names = names;
    $("case").replaceChildren(...["", ...(state.test_names || [])].map((name) => new Option(name || "all tests", name)));
  }
  $("test").disabled = $("case").disabled = !(state.test_names || []).length;
  results.show(state.tests || {});
}

function show_faults(marks = dragged || state.marks || []) {
  const rows = state.faults || [];
  const quick = marks.map((mark) => ({
    text: `${mark.names[0]} and ${mark.names[1]} overlap by ${(100 * mark.depth).toFixed(1)} cm`, names: mark.names, kind: "overlap",
  }));
  const check = state.check;
  const rest = (check?.faults || []).filter((fault) => fault.kind !== "overlap" && fault.kind !== "file");
  const all = [...rows, ...quick, ...(check?.fresh ? rest : [])];
  $("checked").textContent = rows.length ? "the map shows the last valid world" : !check || !check.fresh ? "checking goals and paths …" : all.length ? `${all.length} to correct` : "";
  map.show_faults(new Set(check?.fresh ? rest.flatMap((fault) => fault.names) : []));
  const list = all.map((fault) => {
    const item = document.createElement("li");
    item.textContent = fault.text;
    item.title = fault.title || fault.text;
    if (fault.kind === "gap" || fault.kind === "unchecked") item.className = "amber";
    item.addEventListener("click", () => show_fault(fault));
    return item;
  });
  if (!list.length && check?.fresh) {
    const item = document.createElement("li");
    item.className = "good";
    item.textContent = "No faults.";
    list.push(item);
  }
  $("list").replaceChildren(...list);
}

function show_fault(fault) {
  const keys = new Set();
  for (const [key, parts] of map.nodes) if (parts.some(({ prop }) => fault.names?.includes(prop.name))) keys.add(key);
  if (keys.size) choose(keys);
  if (fault.line) go_to_line(fault.line, fault.line);
}

// --- selection ---

function choose(keys) {
  map.choose(keys);
  show_fields();
  show_status();
}

function show_fields() {
  const box = $("fields");
  if (box.contains(document.activeElement) && typed === null && document.activeElement.dataset.dirty) return;
  box.replaceChildren();
  const add = (tag, text, name = "") => { const node = document.createElement(tag); node.textContent = text; node.className = name; box.append(node); return node; };
  $("mark").style.display = "none";
  if (!map.chosen.size) { add("p", "Click a prop, actor, start, goal, patch or road. Shift and drag selects an area."); return; }
  if (map.chosen.size > 1) { add("p", `${map.chosen.size} elements. Drag one of them to move all.`); return; }
  const key = [...map.chosen][0], element = state.scene.elements[key], count = (map.nodes.get(key) || []).length;
  add("p", `${element.label}: ${element.kind}${element.layout ? `, ${element.layout}` : ""}${count > 1 ? `, ${count} props` : ""}`);
  const lock = element.handles[0].lock;
  if (lock) add("p", lock, "lock");
  else if (element.points) add("p", "Drag a small circle to add a point; double-click a point to remove it.");
  const table = document.createElement("table");
  for (const field of element.fields) {
    const row = table.insertRow(), input = document.createElement("input");
    row.insertCell().textContent = field.label;
    row.insertCell().append(input);
    input.value = field.text ?? field.value;
    input.disabled = field.text === null;
    if (input.disabled) input.title = "comes from an alias or a merge; edit the file by hand";
    input.dataset.path = field.path.join("/");
    input.addEventListener("input", () => { input.dataset.dirty = "1"; });
    input.addEventListener("change", () => {
      delete input.dataset.dirty;
      gesture({ kind: "set", path: field.path, value: input.value });
    });
    input.addEventListener("keydown", (event) => { if (event.key === "Enter") input.blur(); });
  }
  box.append(table);
  if (element.kind === "prop" && count > 1 && element.fields.some((field) => field.label === "prop")) {
    const button = add("button", `Make these ${count} single entries`);
    button.addEventListener("click", () => note(
      "Each prop becomes an entry of its own at its present position; random values are fixed.", false,
      [["Expand", () => gesture({ kind: "expand", element: key })], ["Cancel", () => {}]]));
  }
  if (element.lines) go_to_line(...element.lines);
}

// --- text ---

function show_text(text) {
  const area = $("yaml"), top = area.scrollTop;
  area.value = text;
  area.scrollTop = top;
  show_gutter();
}

function show_gutter() {
  const count = $("yaml").value.split("\n").length;
  $("gutter").textContent = Array.from({ length: count }, (_, index) => index + 1).join("\n");
  $("gutter").scrollTop = $("yaml").scrollTop;
}

function go_to_line(first, last) {
  const area = $("yaml"), height = 18, top = 4 + (first - 1) * height;
  if (top < area.scrollTop || top + height > area.scrollTop + area.clientHeight) area.scrollTop = Math.max(0, top - area.clientHeight / 3);
  const mark = $("mark");
  mark.dataset.top = top;
  mark.style.height = `${(last - first + 1) * height}px`;
  mark.style.display = "block";
  place_mark();
  $("position").textContent = first === last ? `line ${first}` : `lines ${first} to ${last}`;
}

function place_mark() {
  $("mark").style.top = `${Number($("mark").dataset.top) - $("yaml").scrollTop}px`;
  $("gutter").scrollTop = $("yaml").scrollTop;
}

// --- gestures ---

const preview = latest("preview", (reply) => {
  if (!reply.marks) return;
  dragged = reply.marks;
  map.show_marks(dragged);
  show_faults();
});

function gesture(message) {
  preview.cancel();
  note("");
  return ask("gesture", message);
}

// What a gesture adds is chosen, so that it can be moved on.
async function add(message) {
  const before = new Set(Object.keys(state.scene.elements)), reply = await gesture(message);
  if (!reply.error) choose(Object.keys(state.scene.elements).filter((key) => !before.has(key)));
}

const drop = (tile, x, y) => add({ kind: "insert", what: tile.what, name: tile.name, x, y });

function copy() {
  if (map.chosen.size) add({ kind: "copy", elements: [...map.chosen], dx: 1, dy: -1 });
}

function remove() {
  if (map.chosen.size) gesture({ kind: "delete", elements: [...map.chosen] });
}

async function save(overwrite = false) {
  const reply = await ask("save", { overwrite });
  if (!reply.error) return reply;
  if (reply.error && /another program/.test(reply.error)) {
    note(reply.error, true, [["Reload", reload], ["Overwrite", () => save(true)]]);
  }
  return reply;
}

// Other seeds: all of their draws, and one of them above the others.
let ghosts = [];
async function show_ghosts() {
  ghosts = $("ghosts").checked ? (await send("ghosts")).ghosts || [] : [];
  $("seeds").hidden = !$("ghosts").checked;
  $("seed").max = ghosts.length;
  choose_seed();
}

function choose_seed() {
  const chosen = ghosts[Number($("seed").value) - 1], any = ghosts.some(({ outlines }) => outlines?.length);
  map.show_ghosts(ghosts.flatMap(({ outlines }) => outlines || []), chosen?.outlines || []);
  $("seed_name").textContent = !any ? "no random props"
    : !chosen ? `seeds ${ghosts[0].seed} to ${ghosts.at(-1).seed}`
      : `seed ${chosen.seed}${chosen.outlines ? "" : ": cannot be laid out"}`;
  $("take_seed").disabled = !chosen?.outlines;
}

function take_seed() {
  const { seed } = ghosts[Number($("seed").value) - 1];
  $("seed").value = 0;
  gesture({ kind: "set", path: ["seed"], value: String(seed) });
}

// Meshcat is asked for again only when it has drawn the last world.
let drawing = null;
async function show_solid() {
  const view = $("view");
  $("stage").classList.toggle("solid", $("solid").checked);
  view.hidden = !$("solid").checked;
  if (view.dataset.shown !== String(!view.hidden)) map.fit();
  view.dataset.shown = String(!view.hidden);
  if (view.hidden) { view.removeAttribute("src"); return; }
  if (drawing) { drawing = "again"; return; }
  drawing = "now";
  try {
    const reply = await send("draw");
    if (reply.error) note(reply.error, true);
    else if (!view.getAttribute("src")) view.src = "meshcat.html";
  } catch (error) { note("Meshcat does not answer.", true); }
  const again = drawing === "again";
  drawing = null;
  if (again) show_solid();
}

async function run_test(name, stop = false) {
  const reply = await ask("test", { name, stop });
  if (reply.error && !state.saved && !state.read_only) {
    note(reply.error, true, [["Save and run", async () => { if (!(await save()).error) run_test(name); }]]);
  }
}

const results = new Results((name) => run_test(name));

async function fill_palette(names) {
  groups = String(names);
  show_palette($("palette"), (await send("palette")).palette || [], map, options, drop);
}

const gestures = new Gestures(map, {
  choose, copy, remove, gesture,
  hover: (x, y) => { $("readout").textContent = `x ${x.toFixed(2)} m   y ${y.toFixed(2)} m`; },
  preview: (moves, turn = 0) => preview.push({ moves, turn }),
  reject: (text) => note(text, true),
  cancel: () => { preview.cancel(); dragged = null; map.show_marks(state.marks || []); show_faults(); },
  undo: () => ask("undo"), redo: () => ask("redo"), save: () => save(),
}, options);

$("undo").addEventListener("click", () => ask("undo"));
$("redo").addEventListener("click", () => ask("redo"));
$("save").addEventListener("click", () => save());
$("copy").addEventListener("click", copy);
$("delete").addEventListener("click", remove);
$("fit").addEventListener("click", () => map.fit());
$("ghosts").addEventListener("change", show_ghosts);
$("seed").addEventListener("input", choose_seed);
$("take_seed").addEventListener("click", take_seed);
$("solid").addEventListener("change", show_solid);
$("test").addEventListener("click", () => run_test($("case").value, state.tests?.name && state.tests.code === null));
$("yaml").addEventListener("scroll", place_mark);
$("yaml").addEventListener("input", () => {
  show_gutter();
  clearTimeout(typed);
  typed = setTimeout(() => { typed = null; gesture({ kind: "text", value: $("yaml").value }); }, TYPING);
});

map.onview = () => {
  const length = map.step || 10;
  $("scale").querySelector("i").style.width = `${length * map.scale}px`;
  $("scale").querySelector("span").textContent = `${length} m`;
};

async function reload() {
  const reply = await ask("reload");
  // A further change by another program is a new one.
  state.asked = Boolean(reply.error);
  return !reply.error;
}

// If the text is saved, nothing is lost by reading the file again.
async function changed_outside({ saved }) {
  const text = `Another program has changed ${file_name()}.`;
  if (!saved) note(text, true, [["Reload", reload], ["Keep mine", () => {}]]);
  else if (await reload()) note(`${text} It was read again; undo returns to the text before.`);
}

async function poll() {
  if (!pending && typed === null) {
    try {
      const reply = await send("state", { revision: state.revision });
      if (!pending && typed === null) take(reply);
      if (!reply.outside) state.asked = false;
      else if (!state.asked && !gestures.drag) {
        state.asked = true;
        changed_outside(reply);
      }
    } catch (error) { note("The editor does not answer. Is `mirdrake world edit` still running?", true); }
  }
  setTimeout(poll, POLL);
}

window.addEventListener("beforeunload", (event) => { if (!state.saved && !state.read_only) event.preventDefault(); });

await ask("state", { all: true });
show_fields();
document.body.dataset.ready = "1";
if (state.restored) {
  note("This text was not saved when the editor ended. Undo returns to the file.", false, [["Undo", () => ask("undo")], ["Keep it", () => {}]]);
} else if (state.read_only) note(`Read only: ${state.read_only}`, true);
poll();

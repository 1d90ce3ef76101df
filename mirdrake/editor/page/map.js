// The map: a view of the world from above, x to the right and y up, and what the pointer does on it.

const NS = "http://www.w3.org/2000/svg";
const GROUND = { asphalt: "#e3e5e8", concrete: "#e6e6e2", grass: "#dfe9d6", gravel: "#e8e2d8", ice: "#e4eff5" };
const PATCH = { asphalt: "#8f99a5", concrete: "#c9c9c3", grass: "#b5cf9f", gravel: "#c7b99f", ice: "#a9d3ea" };
const KINDS = {
  tree: "#7fae72", house: "#d9b99a", building: "#c3b5a6", barrel: "#e08a3c", cone: "#f2792b", pedestrian: "#9a6ad6",
  cyclist: "#d2691e", sedan: "#8fb3dd", van: "#a8bfd8", wall: "#a7abb1", jersey_barrier: "#b9bcc2", lamp_post: "#70798a",
  stop_sign: "#d9534f", speed_bump: "#e9c65b", traffic_light: "#70798a",
};
const LABEL = [52, 15]; // px of a depth beside an overlap
const FACING = new Set(["sedan", "van", "pedestrian", "cyclist"]);

export function make(tag, attributes = {}, parent = null) {
  const node = document.createElementNS(NS, tag);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  if (parent) parent.append(node);
  return node;
}

export function fill(prop) {
  return prop.color ? `rgb(${prop.color.join(",")})` : KINDS[prop.kind] || "#b7c0cb";
}

export class WorldMap {
  constructor(svg) {
    this.svg = svg;
    this.world = make("g", {}, svg);
    this.layers = Object.fromEntries(["grid", "areas", "ways", "ghosts", "props", "marks", "handles", "over"].map(
      (name) => [name, make("g", { class: `layer-${name}` }, this.world)]));
    this.labels = make("g", {}, svg);
    this.scale = 10; // px per metre
    this.origin = [0, 0]; // px of W's origin
    this.picture = null;
    this.chosen = new Set();
    this.shift = new Map(); // element key -> {dx, dy, turn, cx, cy}
    this.marks = [];
    new ResizeObserver(() => this.draw_view()).observe(svg);
  }

  // --- view ---

  fit(box = this.picture?.view) {
    const { width, height } = this.svg.getBoundingClientRect();
    if (!box || !width) return;
    const [x0, y0, x1, y1] = box;
    this.scale = Math.min((width - 40) / (x1 - x0), (height - 40) / (y1 - y0), 80);
    this.origin = [width / 2 - this.scale * (x0 + x1) / 2, height / 2 + this.scale * (y0 + y1) / 2];
    this.draw_view();
  }

  zoom(factor, px, py) {
    const scale = Math.min(400, Math.max(0.2, this.scale * factor)), used = scale / this.scale;
    this.origin = [px + (this.origin[0] - px) * used, py + (this.origin[1] - py) * used];
    this.scale = scale;
    this.draw_view();
  }

  pan(dx, dy) {
    this.origin = [this.origin[0] + dx, this.origin[1] + dy];
    this.draw_view();
  }

  to_world(event) {
    const box = this.svg.getBoundingClientRect();
    return [(event.clientX - box.left - this.origin[0]) / this.scale, -(event.clientY - box.top - this.origin[1]) / this.scale];
  }

  to_screen(x, y) { return [this.origin[0] + this.scale * x, this.origin[1] - this.scale * y]; }

  draw_view() {
    this.world.setAttribute("transform", `translate(${this.origin}) scale(${this.scale} ${-this.scale})`);
    this.draw_grid();
    this.draw_handles();
    this.draw_labels();
    this.onview?.();
  }

  draw_grid() {
    const { width, height } = this.svg.getBoundingClientRect(), layer = this.layers.grid;
    const steps = [0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500];
    const step = steps.find((one) => one * this.scale > 36) || 1000;
    const x0 = -this.origin[0] / this.scale, x1 = x0 + width / this.scale;
    const y1 = this.origin[1] / this.scale, y0 = y1 - height / this.scale;
    layer.replaceChildren();
    for (let x = Math.ceil(x0 / step) * step; x <= x1; x += step) make("path", { class: "grid", d: `M${x} ${y0}V${y1}` }, layer);
    for (let y = Math.ceil(y0 / step) * step; y <= y1; y += step) make("path", { class: "grid", d: `M${x0} ${y}H${x1}` }, layer);
    this.step = step;
  }

  // --- content ---

  show(picture) {
    const first = this.picture === null;
    // Random props are drawn again when others take their positions: ghosts show where they were.
    const now = new Map(picture.props.map((prop) => [prop.name, prop]));
    this.show_ghosts((this.picture?.props || []).filter(
      (old) => old.random && now.has(old.name) && now.get(old.name).d !== old.d && !this.shift.has(old.key)).map((old) => old.d));
    this.picture = picture;
    this.svg.style.background = GROUND[picture.ground] || GROUND.asphalt;
    const { areas, props } = this.layers;
    areas.replaceChildren();
    for (const area of picture.areas) {
      const node = make("path", { class: area.layer, d: area.d }, areas);
      if (area.layer === "patch" && PATCH[area.surface]) node.style.fill = PATCH[area.surface];
      this.name_node(node, { goal: `goals/${area.name}`, road: `tracks/${area.name}` }[area.layer] || this.patch_key(area));
      make("title", {}, node).textContent = area.name || area.layer;
    }
    for (const line of picture.lines) {
      const attributes = { class: line.layer, d: line.d, "stroke-width": line.width || 0.25 };
      if (line.dash) attributes["stroke-dasharray"] = line.dash.join(" ");
      const node = make("path", attributes, areas);
      if (line.layer === "centre") this.name_node(node, `tracks/${line.name}`);
    }
    for (const d of picture.clear) make("title", {}, make("path", { class: "clear", d }, areas)).textContent = "to be kept clear";
    this.layers.ways.replaceChildren();
    for (const [key, element] of Object.entries(picture.elements)) {
      for (const { role, d, moves } of element.outlines) {
        const node = make("path", { class: role, d }, this.layers.ways);
        this.name_node(node, key);
        if (!moves) node.dataset.fixed = "1";
        make("title", {}, node).textContent = `${role} of ${element.label}`;
      }
    }
    props.replaceChildren();
    this.nodes = new Map();
    for (const prop of [...picture.props].sort((a, b) => a.top - b.top)) {
      const group = make("g", { class: "element", "data-key": prop.key, "data-name": prop.name }, props);
      const body = make("path", { class: `prop${prop.random ? " random" : ""}${prop.key.startsWith("actors/") ? " actor" : ""}`, d: prop.d, fill: fill(prop) }, group);
      make("title", {}, body).textContent = `${prop.name}: ${prop.kind} at (${prop.x.toFixed(2)}, ${prop.y.toFixed(2)}) m`;
      // A pedestrian or a cone is too small to be seen and hit on a map of a whole street.
      if (prop.small) make("path", { class: "dot", d: `M${prop.x} ${prop.y}h0`, stroke: fill(prop) }, group);
      if (FACING.has(prop.kind)) {
        const c = Math.cos(prop.yaw), s = Math.sin(prop.yaw), l = prop.length;
        const at = (u, v) => `${prop.x + c * u * l - s * v * l} ${prop.y + s * u * l + c * v * l}`;
        make("path", { class: "front", d: `M${at(0.47, 0)}L${at(0.34, 0.12)}L${at(0.34, -0.12)}Z` }, group);
      }
      if (!this.nodes.has(prop.key)) this.nodes.set(prop.key, []);
      this.nodes.get(prop.key).push({ prop, group, body });
    }
    for (const start of picture.starts) {
      const transform = `translate(${start.x} ${start.y}) rotate(${start.yaw * 180 / Math.PI})`;
      const group = make("g", { class: "element", "data-key": start.key }, props);
      const node = make("path", { class: "start prop", transform, d: "M0 .5H2.2V1.1L4 0L2.2-1.1V-.5H0Z" }, group);
      make("title", {}, node).textContent = `start ${start.name}`;
      if (!this.nodes.has(start.key)) this.nodes.set(start.key, []);
      this.nodes.get(start.key).push({ prop: start, group, body: node });
    }
    this.chosen = new Set([...this.chosen].filter((key) => key in picture.elements));
    this.shift.clear();
    if (first) this.fit();
    this.draw_choice();
    this.draw_view();
  }

  // Nodes of an element have its key: a click on them selects it.
  name_node(node, key) {
    if (!key || !(key in this.picture.elements)) return;
    node.classList.add("element");
    node.dataset.key = key;
  }

  patch_key(area) {
    if (area.layer !== "patch") return null;
    const keys = Object.keys(this.picture.elements).filter((key) => key.startsWith("ground/patches/"));
    return keys.find((key) => this.picture.elements[key].label === area.name) || keys.find((key) => `patch_${key.split("/")[2]}` === area.name) || null;
  }

  choose(keys) {
    this.chosen = new Set(keys);
    this.draw_choice();
    this.draw_handles();
  }

  draw_choice() {
    // Above all others, or a low prop would be hidden by the one that it is dragged into.
    for (const key of this.chosen) for (const { group } of this.nodes.get(key) || []) this.layers.props.append(group);
    for (const node of this.svg.querySelectorAll(".chosen")) node.classList.remove("chosen");
    for (const node of this.svg.querySelectorAll("[data-key]")) {
      if (this.chosen.has(node.dataset.key)) (node.querySelector(".prop") || node).classList.add("chosen");
    }
  }

  // Displace the elements while they are dragged; the server has not changed them yet.
  displace(key, shift) {
    this.shift.set(key, shift);
    const turn = shift.turn ? ` rotate(${shift.turn * 180 / Math.PI} ${shift.cx} ${shift.cy})` : "";
    for (const node of this.svg.querySelectorAll(`[data-key="${CSS.escape(key)}"]:not([data-fixed])`)) {
      node.setAttribute("transform", `translate(${shift.dx} ${shift.dy})${turn}`);
    }
    this.draw_handles();
  }

  settle() {
    this.shift.clear();
    for (const node of this.svg.querySelectorAll("[data-key]")) node.removeAttribute("transform");
    this.draw_handles();
  }

  draw_handles() {
    const layer = this.layers.handles;
    layer.replaceChildren();
    if (!this.picture || this.chosen.size !== 1) return;
    const key = [...this.chosen][0], element = this.picture.elements[key], shift = this.shift.get(key);
    const moved = (handle) => shift && !shift.handle ? [handle.x + shift.dx, handle.y + shift.dy] : [handle.x, handle.y];
    const body = element.handles[0], place = (handle) => shift?.handle === handle.name ? [shift.x, shift.y] : moved(handle);
    if (element.points) this.draw_points(element, place, layer);
    for (const handle of element.handles) {
      if (handle.x === null || handle.y === null) continue;
      const [x, y] = place(handle);
      if (handle.name === "yaw" || handle.name === "radius") {
        const [bx, by] = moved(body);
        make("path", { class: "arm", d: `M${bx} ${by}L${x} ${y}` }, layer);
      }
      if (handle.name === "body" && element.layout === "at" && element.kind !== "goal") continue;
      const kind = `${handle.lock ? " lock" : ""}${handle.name.startsWith("trigger") ? " when" : ""}`;
      const size = 5.5 / this.scale, name = `handle${kind}`;
      // A square beside the middle of the points, where it hides none of them, moves all of them.
      const node = element.points && handle.name === "body"
        ? make("rect", { class: name, x: x + 2 * size, y: y - 4 * size, width: 2 * size, height: 2 * size }, layer)
        : make("circle", { class: name, cx: x, cy: y, r: size }, layer);
      node.dataset.handle = handle.name;
      make("title", {}, node).textContent = handle.lock || handle.name;
    }
  }

  // The points of a path or road joined by lines, with small handles between them that add a point.
  draw_points(element, place, layer) {
    const points = element.handles.filter((handle) => handle.name.startsWith("point ")).map(place);
    if (points.length < 2) return;
    make("path", { class: "arm", d: `M${points.map((point) => point.join(" ")).join("L")}${element.closed ? "Z" : ""}` }, layer);
    if (element.handles[0].lock) return;
    points.forEach(([x, y], index) => {
      const [u, v] = points[(index + 1) % points.length];
      if (index + 1 === points.length && !element.closed) return;
      const node = make("circle", { class: "handle between", cx: (x + u) / 2, cy: (y + v) / 2, r: 3.5 / this.scale }, layer);
      node.dataset.insert = index + 1;
      make("title", {}, node).textContent = "drag to add a point";
    });
  }

  // Props that break a rule, as the complete check finds.
  show_faults(names) {
    for (const parts of this.nodes?.values() || []) {
      for (const { prop, body } of parts) body.classList.toggle("broken", names.has(prop.name));
    }
  }

  show_marks(marks) {
    this.marks = marks;
    const bad = new Set(marks.flatMap((mark) => mark.names));
    for (const parts of this.nodes?.values() || []) {
      for (const { prop, body } of parts) body.classList.toggle("overlap", bad.has(prop.name));
    }
    this.draw_labels();
  }

  draw_labels() {
    this.labels.replaceChildren();
    const drawn = [];
    for (const mark of this.marks) {
      const depth = mark.depth >= 0.01 ? `${(100 * mark.depth).toFixed(0)} cm` : `${(1000 * mark.depth).toFixed(1)} mm`;
      let [x, y] = this.to_screen(mark.x, mark.y);
      [x, y] = [x + 8, y - 8];
      // Above the labels that are there already.
      const hidden = () => drawn.find((other) => Math.abs(other[0] - x) < LABEL[0] && Math.abs(other[1] - y) < LABEL[1]);
      for (let other = hidden(); other; other = hidden()) y = other[1] - LABEL[1];
      drawn.push([x, y]);
      make("text", { class: "depth", x, y }, this.labels).textContent = depth;
    }
  }

  show_ghosts(paths, chosen = []) {
    this.layers.ghosts.replaceChildren(...paths.map((d) => make("path", { class: "ghost", d })),
      ...chosen.map((d) => make("path", { class: "ghost one", d })));
  }

  rubber_band(from, to) {
    const layer = this.layers.over;
    layer.replaceChildren();
    if (from) make("path", { class: "band", d: `M${from[0]} ${from[1]}H${to[0]}V${to[1]}H${from[0]}Z` }, layer);
  }

  inside(from, to) {
    const [x0, x1] = [from[0], to[0]].sort((a, b) => a - b), [y0, y1] = [from[1], to[1]].sort((a, b) => a - b);
    const keys = new Set();
    for (const [key, parts] of this.nodes) {
      if (parts.some(({ prop }) => prop.x >= x0 && prop.x <= x1 && prop.y >= y0 && prop.y <= y1)) keys.add(key);
    }
    return keys;
  }
}

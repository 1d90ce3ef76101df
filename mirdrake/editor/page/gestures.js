// What the pointer and the keys do: choose, drag, turn, copy, delete, pan, zoom, drop from the palette.

const GRID = 0.5; // m
const ANGLE = Math.PI / 12; // 15 degrees
const STILL = 3; // px that a press may move and still be a click
const TWICE = 400; // ms between the clicks of a double click

export class Gestures {
  constructor(map, actions, options) {
    Object.assign(this, { map, actions, options });
    this.drag = null;
    const svg = map.svg;
    svg.addEventListener("pointerdown", (event) => this.down(event));
    svg.addEventListener("pointermove", (event) => this.move(event));
    svg.addEventListener("pointerup", (event) => this.up(event));
    svg.addEventListener("pointercancel", () => this.stop());
    svg.addEventListener("contextmenu", (event) => event.preventDefault());
    svg.addEventListener("wheel", (event) => {
      event.preventDefault();
      const box = svg.getBoundingClientRect();
      map.zoom(Math.exp(-0.0015 * event.deltaY), event.clientX - box.left, event.clientY - box.top);
    }, { passive: false });
    window.addEventListener("keydown", (event) => this.key(event));
  }

  snapped(value, event) { return this.options.snap() && !event.altKey ? Math.round(value / GRID) * GRID : value; }

  down(event) {
    this.map.svg.focus();
    this.map.svg.setPointerCapture(event.pointerId);
    const start = this.map.to_world(event), screen = [event.clientX, event.clientY];
    if (event.button === 1 || event.button === 2) {
      this.drag = { kind: "pan", screen };
      return;
    }
    const handle = event.target.closest?.("[data-handle]"), node = event.target.closest?.("[data-key]");
    const between = event.target.closest?.("[data-insert]");
    if (between) {
      this.drag = { kind: "insert", key: [...this.map.chosen][0], index: Number(between.dataset.insert), node: between, start, screen };
    } else if (node && (node.dataset.key.startsWith("tracks/") || node.dataset.fixed) && !event.shiftKey) {
      // A road covers much of the map: a click selects it, a drag on it moves the map. Its handles move the road.
      this.drag = { kind: "pan", start, screen, empty: true, pick: [node.dataset.key] };
    } else if (handle?.dataset.handle === "body") {
      this.drag = { kind: "body", keys: [...this.map.chosen], start, screen };
    } else if (handle) {
      this.drag = { kind: "handle", key: [...this.map.chosen][0], handle: handle.dataset.handle, start, screen };
    } else if (node) {
      const key = node.dataset.key, chosen = this.map.chosen;
      if (event.shiftKey || event.ctrlKey) {
        const keys = new Set(chosen);
        keys.has(key) ? keys.delete(key) : keys.add(key);
        this.actions.choose(keys);
      } else if (!chosen.has(key)) this.actions.choose([key]);
      this.drag = { kind: "body", keys: [...this.map.chosen], start, screen };
    } else {
      this.drag = { kind: event.shiftKey ? "band" : "pan", start, screen, empty: true };
    }
  }

  move(event) {
    const [x, y] = this.map.to_world(event), drag = this.drag;
    this.actions.hover(x, y);
    if (!drag) return;
    const far = Math.hypot(event.clientX - drag.screen[0], event.clientY - drag.screen[1]) > STILL;
    if (!drag.moved && !far) return;
    drag.moved = true;
    this.map.svg.classList.add("dragging");
    if (drag.kind === "pan") {
      this.map.pan(event.clientX - drag.screen[0], event.clientY - drag.screen[1]);
      drag.screen = [event.clientX, event.clientY];
    } else if (drag.kind === "band") {
      this.map.rubber_band(drag.start, [x, y]);
    } else if (drag.kind === "insert") {
      drag.place = [this.snapped(x, event), this.snapped(y, event)];
      drag.node.setAttribute("cx", drag.place[0]);
      drag.node.setAttribute("cy", drag.place[1]);
    } else if (drag.kind === "body") {
      drag.moves = this.body_moves(drag, x, y, event);
      if (drag.moves) this.actions.preview(drag.moves);
    } else {
      drag.moves = this.handle_moves(drag, x, y, event);
      if (drag.moves) this.actions.preview(drag.moves, drag.turn || 0);
    }
  }

  // The displacement is that which puts the first element on the snapping grid.
  body_moves(drag, x, y, event) {
    const { elements } = this.map.picture;
    for (const key of drag.keys) {
      const lock = elements[key].handles[0].lock;
      if (lock) {
        if (!drag.rejected) this.actions.reject(`${elements[key].label}: ${lock}`);
        drag.rejected = true;
        return null;
      }
    }
    const first = elements[drag.keys[0]].handles[0];
    const dx = this.snapped(first.x + x - drag.start[0], event) - first.x;
    const dy = this.snapped(first.y + y - drag.start[1], event) - first.y;
    return drag.keys.map((key) => {
      const body = elements[key].handles[0];
      this.map.displace(key, { dx, dy });
      return { element: key, handle: "body", x: body.x + dx, y: body.y + dy };
    });
  }

  handle_moves(drag, x, y, event) {
    const element = this.map.picture.elements[drag.key], body = element.handles[0];
    const handle = element.handles.find((one) => one.name === drag.handle);
    if (handle.lock) {
      if (!drag.rejected) this.actions.reject(`${element.label}: ${handle.lock}`);
      drag.rejected = true;
      return null;
    }
    if (drag.handle === "yaw") {
      let angle = Math.atan2(y - body.y, x - body.x);
      if (this.options.snap() && !event.altKey) angle = Math.round(angle / ANGLE) * ANGLE;
      const reach = Math.hypot(handle.x - body.x, handle.y - body.y), before = Math.atan2(handle.y - body.y, handle.x - body.x);
      const place = [body.x + reach * Math.cos(angle), body.y + reach * Math.sin(angle)];
      drag.turn = angle - before;
      this.map.displace(drag.key, { dx: 0, dy: 0, turn: drag.turn, cx: body.x, cy: body.y, handle: "yaw", x: place[0], y: place[1] });
      return [{ element: drag.key, handle: "yaw", x: place[0], y: place[1] }];
    }
    const place = [this.snapped(x, event), this.snapped(y, event)];
    this.map.displace(drag.key, { dx: 0, dy: 0, handle: drag.handle, x: place[0], y: place[1] });
    return [{ element: drag.key, handle: drag.handle, x: place[0], y: place[1] }];
  }

  up(event) {
    const drag = this.drag;
    this.drag = null;
    this.map.svg.classList.remove("dragging");
    if (!drag) return;
    if (drag.kind === "band" && drag.moved) {
      this.actions.choose(this.map.inside(drag.start, this.map.to_world(event)));
      this.map.rubber_band(null);
    } else if (drag.empty && !drag.moved) {
      this.actions.choose(drag.pick || []);
    } else if (drag.kind === "insert" && drag.moved) {
      this.actions.gesture({ kind: "insert_point", element: drag.key, index: drag.index, x: drag.place[0], y: drag.place[1] });
    } else if (drag.moves) {
      this.actions.gesture({ kind: "drag", moves: drag.moves });
    } else if (drag.kind === "handle" && !drag.moved) {
      this.click_point(drag, event.timeStamp);
    }
  }

  // A double click on a point removes it.
  click_point(drag, time) {
    const number = /^point (\d+)$/.exec(drag.handle), last = this.clicked;
    this.clicked = { handle: drag.handle, key: drag.key, time };
    if (!number || last?.handle !== drag.handle || last.key !== drag.key || time - last.time > TWICE) return;
    this.clicked = null;
    this.actions.gesture({ kind: "delete_point", element: drag.key, index: Number(number[1]) });
  }

  stop() {
    this.drag = null;
    this.map.rubber_band(null);
    this.map.settle();
    this.actions.cancel();
  }

  key(event) {
    const typing = /^(INPUT|TEXTAREA|SELECT)$/.test(event.target.tagName), command = event.ctrlKey || event.metaKey;
    const letter = event.key.toLowerCase();
    if (command && letter === "s") { event.preventDefault(); this.actions.save(); return; }
    if (typing) return;
    if (command && letter === "z") { event.preventDefault(); event.shiftKey ? this.actions.redo() : this.actions.undo(); }
    else if (command && letter === "y") { event.preventDefault(); this.actions.redo(); }
    else if (command && letter === "d") { event.preventDefault(); this.actions.copy(); }
    else if (event.key === "Delete" || event.key === "Backspace") { event.preventDefault(); this.actions.remove(); }
    else if (event.key === "Escape") { this.stop(); this.actions.choose([]); }
    else if (letter === "f" && !command) this.map.fit();
    else if (event.key.startsWith("Arrow") && this.map.chosen.size) {
      event.preventDefault();
      this.nudge({ ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key], event);
    }
  }

  nudge([dx, dy], event) {
    const length = event.shiftKey ? 0.05 : GRID, { elements } = this.map.picture, moves = [];
    for (const key of this.map.chosen) {
      const body = elements[key].handles[0];
      if (body.lock) { this.actions.reject(`${elements[key].label}: ${body.lock}`); return; }
      moves.push({ element: key, handle: "body", x: body.x + dx * length, y: body.y + dy * length });
    }
    this.actions.gesture({ kind: "drag", moves });
  }
}

// Tiles of the palette are dragged onto the map; a click drops them in the middle of the view.
export function make_draggable(tile, map, options, drop) {
  tile.addEventListener("pointerdown", (event) => {
    event.preventDefault();
    tile.setPointerCapture(event.pointerId);
    const up = (end) => {
      tile.removeEventListener("pointerup", up);
      const box = map.svg.getBoundingClientRect();
      const over = end.clientX > box.left && end.clientX < box.right && end.clientY > box.top && end.clientY < box.bottom;
      const place = over ? map.to_world(end)
        : Math.hypot(end.clientX - event.clientX, end.clientY - event.clientY) < STILL
          ? map.to_world({ clientX: (box.left + box.right) / 2, clientY: (box.top + box.bottom) / 2 }) : null;
      if (!place) return;
      const snap = (value) => options.snap() && !end.altKey ? Math.round(value / GRID) * GRID : value;
      drop(snap(place[0]), snap(place[1]));
    };
    tile.addEventListener("pointerup", up);
  });
}

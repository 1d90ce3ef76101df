(() => {
  const about = JSON.parse(document.getElementById("about").textContent);
  const get = id => document.getElementById(id);
  const page = Math.random().toString(36).slice(2);
  const degrees = 180 / Math.PI;
  get("what").textContent = `${about.vehicle} · ${about.world}`;

  // --- talking to the drive ---
  async function post(path, message) {
    const answer = await fetch(path, { method: "POST", body: JSON.stringify(message), keepalive: true,
      headers: { "Content-Type": "application/json" } });
    if (!answer.ok) throw new Error(`${path}: ${answer.status}`);
    return answer.json();
  }
  const order = message => post("order", message).catch(() => {});

  // --- manual input ---
  const held = new Set();
  const codes = { ArrowUp: "up", KeyW: "up", ArrowDown: "down", KeyS: "down", ArrowLeft: "left", KeyA: "left",
    ArrowRight: "right", KeyD: "right", Space: "stop" };
  const presses = { KeyR: () => order({ do: "reset" }), KeyP: () => order({ do: "pause" }),
    KeyC: () => order({ do: "record" }), KeyH: () => get("fold").click() };
  let touched = false;  // something was pressed or moved since the last report
  let sliding = { speed: null, steering: null };
  addEventListener("keydown", event => {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const key = codes[event.code];
    if (key) {
      event.preventDefault();
      touched = true;
      get("help").hidden = true;
      sliding = { speed: null, steering: null };
      held.add(key);
    } else if (presses[event.code] && !event.repeat) presses[event.code]();
    else if (/^Digit[123]$/.test(event.code)) look(Number(event.code.slice(5)) - 1);
  });
  addEventListener("keyup", event => held.delete(codes[event.code]));
  addEventListener("blur", () => held.clear());
  let buttons = [];
  function readPad() {
    const pads = navigator.getGamepads ? [...navigator.getGamepads()].filter(one => one && one.connected) : [];
    get("pad").textContent = pads.length ? "Game pad: left stick steers, right trigger accelerates, left trigger brakes, A stops, Start pauses, Back resets."
      : "Game pad: press one of its buttons to connect.";
    if (!pads.length) return null;
    const value = number => pads[0].buttons[number] ? pads[0].buttons[number].value : 0;
    const dead = (x, zone) => Math.abs(x) < zone ? 0 : (Math.abs(x) - zone) / (1 - zone) * Math.sign(x);
    const now = [8, 9].map(number => value(number) > 0.5);
    if (now[0] && !buttons[0]) order({ do: "reset" });
    if (now[1] && !buttons[1]) order({ do: "pause" });
    buttons = now;
    const x = dead(pads[0].axes[0] || 0, 0.08);
    const pad = { steer: -Math.sign(x) * Math.abs(x) ** 1.5, throttle: dead(value(7), 0.04), brake: dead(value(6), 0.04),
      stop: value(0) > 0.5 };
    return pad.steer || pad.throttle || pad.brake || pad.stop ? pad : null;
  }
  function manualInput() {
    const pad = readPad();
    if (pad) sliding = { speed: null, steering: null };
    const down = key => held.has(key) ? 1 : 0;
    const keys = down("left") - down("right");
    const message = { page, hidden: document.hidden, view: views[shown].name,
      active: touched || held.size > 0 || pad !== null,
      throttle: Math.max(down("up"), pad ? pad.throttle : 0), brake: Math.max(down("down"), pad ? pad.brake : 0),
      steer: keys || (pad ? pad.steer : 0), analog: !keys && pad !== null, stop: down("stop") > 0 || (pad !== null && pad.stop),
      ...sliding };
    touched = false;
    return message;
  }

  // --- the report, and what comes back ---
  let silent = 0;
  async function talk() {
    for (;;) {
      const began = performance.now();
      try {
        const readings = await post("report", manualInput());
        if (silent) write("note", note);
        silent = 0;
        show(readings);
      } catch {
        if (++silent > 3) {
          status("no answer", "red");
          write("note", "No answer: the drive has ended, or the connection is lost.");
          get("note").className = "alarm";
          get("note").hidden = false;
        }
      }
      await new Promise(done => setTimeout(done, Math.max(5, (silent ? 500 : 33) - (performance.now() - began))));
    }
  }

  // --- views ---
  const views = about.views;
  let shown = 0;
  const viewButtons = views.map((view, number) => {
    const button = document.createElement("button");
    button.textContent = view.name;
    button.title = `key ${number + 1}`;
    button.onclick = () => { look(number); button.blur(); };
    get("viewbuttons").append(button);
    return button;
  });
  function look(number) {
    if (!views[number]) return;
    shown = number;
    // Meshcat's scene has its y axis upwards.
    const [eye, target] = [views[number].eye, views[number].target].map(([x, y, z]) => [x, z, -y]);
    viewer.handle_command({ type: "set_transform", path: "/Cameras/default",
      matrix: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1] });
    viewer.handle_command({ type: "set_target", value: target });
    viewer.handle_command({ type: "set_property", path: "/Cameras/default/rotated/<object>", property: "position",
      value: eye });
    viewer.set_dirty();
    viewButtons.forEach((button, index) => button.classList.toggle("on", index === number));
  }

  // A picture is begun when the last one is done and as much time has passed again, so that a slow renderer leaves half
  // the machine to the drive; where pictures take long they get coarser, and finer again where there is time.
  const gl = viewer.renderer.getContext(), sharpest = Math.min(devicePixelRatio, 1.5);
  let next = 0, began = 0, fence = null, usual = 30, sharp = sharpest, settled = 0;
  viewer.animate = () => {
    const now = performance.now();
    if (fence) {
      if (gl.getSyncParameter(fence, gl.SYNC_STATUS) !== gl.SIGNALED && now - began < 3000) return;
      gl.deleteSync(fence);
      fence = null;
      const took = now - began;
      usual += 0.3 * (took - usual);
      next = now + (took > 40 ? took : 0);
      if (now > settled) {
        const wanted = usual > 150 ? sharp / 1.4 : usual < 35 ? sharp * 1.2 : sharp;
        const bounded = Math.min(Math.max(wanted, 0.5), sharpest);
        if (bounded !== sharp) {  // which empties the canvas
          sharp = bounded;
          viewer.renderer.setPixelRatio(sharp);
          viewer.set_dirty();
          settled = now + 1500;
          usual = 60;
          next = now;
        }
      }
    }
    if (now < next) return;
    viewer.animator.update();
    if (!viewer.needs_render) return;
    viewer.render();
    began = performance.now();
    next = now + 25;
    fence = gl.fenceSync ? gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0) : null;
    gl.flush();
    document.body.dataset.picture = `${Math.round(usual)} ms, ${sharp.toFixed(2)}`;
  };

  // --- overlays, sliders, gains, buttons ---
  const blend = (...colours) => `linear-gradient(90deg, ${colours.join(", ")})`;
  const layers = { driven: ["driven path", "#1a6bf2", "path of the rear axle"],
    planned: ["planned path", blend("#0da64d 50%", "#fa9e0d 50%"), "green: centre line; orange: arc of the present steering angle"],
    lidar: ["lidar points", blend("#00f", "#7f7", "#f00"), "blue on the ground, red above the vehicle"],
    contacts: ["contact forces", "#e61a26", "forces of all contacts"],
    tyres: ["tyre forces", "#8c26d9", "tangential forces of the road on the tyres"],
    friction: ["friction", blend("#e62026", "#0db326"), "red: low; green: high"] };
  const boxes = {};
  for (const [name, [words, colour, meaning]] of Object.entries(layers)) {
    const label = document.createElement("label"), box = document.createElement("input"), mark = document.createElement("i");
    box.type = "checkbox";
    box.id = `layer-${name}`;
    mark.style.background = colour;
    label.append(box, mark, words);
    label.title = meaning;
    if (!about.layers.includes(name)) {
      box.disabled = true;
      mark.style.background = "#d5dbe3";
      label.className = "none";
      label.title = "not available in this drive";
    }
    box.onchange = () => { order({ do: "layer", name, on: box.checked }); box.blur(); };
    get("layers").append(label);
    boxes[name] = box;
  }
  const speed = get("speedslider"), steering = get("steeringslider");
  speed.min = -Math.floor(about.backward * 3.6); speed.max = Math.floor(about.forward * 3.6); speed.value = 0;
  const lock = Math.floor(about.steering * degrees * 2) / 2;
  steering.min = -lock; steering.max = lock; steering.value = 0;
  speed.oninput = () => { sliding.speed = speed.value / 3.6; sliding.steering ??= -steering.value / degrees; touched = true; };
  steering.oninput = () => { sliding.steering = -steering.value / degrees; sliding.speed ??= speed.value / 3.6; touched = true; };
  for (const one of [speed, steering]) one.onchange = () => one.blur();
  const gains = {};
  for (const gain of about.gains) {
    const label = document.createElement("label"), name = document.createElement("span");
    const value = document.createElement("output"), slider = document.createElement("input");
    label.className = "slider";
    name.textContent = gain.path + (gain.unit ? ` [${gain.unit}]` : "");
    Object.assign(slider, { type: "range", min: 0, max: gain.most, step: gain.most / 200, value: gain.given });
    slider.id = `gain-${gain.path}`;
    slider.oninput = () => order({ do: "gain", name: gain.path, value: Number(slider.value) });
    slider.onchange = () => slider.blur();
    label.append(name, value, slider);
    get("gains").append(label);
    gains[gain.path] = { slider, value, given: gain.given };
  }
  if (!about.gains.length) get("gains").textContent = "no gains that can be changed while driving";
  get("given").onclick = () => {
    for (const [name, gain] of Object.entries(gains)) order({ do: "gain", name, value: gain.given });
    get("given").blur();
  };
  for (const name of ["reset", "pause", "record"]) get(name).onclick = () => { order({ do: name }); get(name).blur(); };
  get("fold").onclick = () => { get("side").classList.toggle("folded"); get("fold").blur(); centre(); };
  function centre() {  // the vehicle in the middle of what the panel leaves free
    const width = innerWidth, height = innerHeight, panel = width - get("side").getBoundingClientRect().left;
    const covered = get("side").classList.contains("folded") ? 0 : Math.min(panel, 0.4 * width);
    viewer.camera.setViewOffset(width, height, covered / 2, 0, width, height);
    document.body.style.setProperty("--middle", `${(width - covered) / 2}px`);
    viewer.set_dirty();
  }
  addEventListener("resize", centre);

  // --- gauges ---
  const from = -220, to = 40;  // degrees on the dial
  const top = Math.max(20, Math.ceil(about.forward * 3.6 / 20) * 20);
  const at = (angle, radius) => [100 + radius * Math.cos(angle / degrees), 92 + radius * Math.sin(angle / degrees)];
  function arc(a, b, radius) {
    const [x, y] = at(a, radius), [u, v] = at(b, radius);
    return `M${x.toFixed(1)} ${y.toFixed(1)}A${radius} ${radius} 0 ${b - a > 180 ? 1 : 0} 1 ${u.toFixed(1)} ${v.toFixed(1)}`;
  }
  const angleOf = kmh => from + (to - from) * Math.min(Math.max(kmh / top, 0), 1);
  get("dialback").setAttribute("d", arc(from, to, 80));
  const step = top > 100 ? 40 : top > 40 ? 20 : 5;
  for (let mark = 0; mark <= top; mark += step) {
    const text = document.createElementNS("http://www.w3.org/2000/svg", "text"), [x, y] = at(angleOf(mark), 60);
    text.setAttribute("x", x); text.setAttribute("y", y + 4); text.setAttribute("text-anchor", "middle");
    text.setAttribute("class", "tick");
    text.textContent = mark;
    get("ticks").append(text);
  }
  const written = {};  // what is the same again is left alone, or the browser would paint it again
  function write(id, words, attribute = "") {
    if (written[id + attribute] === words) return;
    written[id + attribute] = words;
    if (attribute) get(id).setAttribute(attribute, words);
    else get(id).textContent = words;
  }
  function status(words, kind) {
    write("state", words);
    get("state").className = `pill ${kind}`;
  }
  let note = "", noteUntil = 0, showNext = 0;
  function show(readings) {
    document.body.dataset.readings = JSON.stringify(readings);
    remember(readings);
    if (performance.now() < showNext) return;
    showNext = performance.now() + (usual > 60 ? 200 : 30);  // each change costs a slow renderer a whole page
    const kmh = readings.speed * 3.6;
    const alarm = readings.alarm;
    const moves = Math.abs(kmh) > 0.7 || readings.speed_command !== 0;
    if (alarm) status("input lost", "red");
    else if (readings.paused) status("paused: press P to continue", "amber");
    else if (readings.lost && moves) status("no input: braking", "amber");
    else if (moves) status(readings.speed_command < 0 || kmh < -0.7 ? "reversing" : "driving", "");
    else status("ready: press ↑ or W", "");
    write("clock", `${readings.time.toFixed(1)} s`);
    write("factor", readings.factor === null ? "stopped" : `${readings.factor.toFixed(2)} × real time`);
    get("factor").className = `pill ${readings.factor !== null && readings.factor < 0.95 ? "amber" : "quiet"}`;
    get("recording").hidden = !readings.recording;
    write("record", readings.recording ? "■ Stop" : "● Record");
    write("pause", readings.paused ? "Continue" : "Pause");
    get("pause").classList.toggle("on", readings.paused);
    if (readings.message !== note) {
      note = readings.message;
      noteUntil = performance.now() + 7000;
      write("note", note);
    }
    get("note").className = alarm ? "alarm" : "";
    get("note").hidden = !note || (!alarm && performance.now() > noteUntil);

    write("speed", Math.abs(kmh).toFixed(0));
    write("dialarc", Math.abs(kmh) < 0.3 ? "" : arc(from, Math.max(angleOf(Math.abs(kmh)), from + 0.1), 80), "d");
    const [x, y] = at(angleOf(Math.abs(readings.speed_command * 3.6)), 70), [u, v] = at(angleOf(Math.abs(readings.speed_command * 3.6)), 90);
    write("dialmark", moves ? `M${x.toFixed(1)} ${y.toFixed(1)}L${u.toFixed(1)} ${v.toFixed(1)}` : "", "d");
    write("setpoint", moves ? `set-point ${Math.abs(readings.speed_command * 3.6).toFixed(0)}` : "");
    write("gear", readings.speed_command < -0.05 || kmh < -0.3 ? "R" : Math.abs(kmh) < 0.3 && readings.speed_command === 0 ? "N" : "D");
    write("rim", `rotate(${(-readings.steering / about.steering * 135).toFixed(1)})`, "transform");
    write("angle", `${Math.abs(readings.steering * degrees).toFixed(1)}° ${readings.steering > 0.0009 ? "left" : readings.steering < -0.0009 ? "right" : ""}`);
    get("lane").classList.toggle("none", readings.lateral === null);
    if (readings.lateral === null) write("lateral", "no track");
    else {
      write("offset", 98 - Math.max(-1, Math.min(1, readings.lateral / about.lane)) * 86, "x");
      write("offset", Math.abs(readings.lateral) > about.lane ? "#e03131" : "#1f6feb", "fill");
      write("lateral", `${Math.abs(readings.lateral).toFixed(2)} m ${readings.lateral > 0.005 ? "left" : readings.lateral < -0.005 ? "right" : ""}`);
    }
    write("distance", readings.distance < 1000 ? `${readings.distance.toFixed(0)} m` : `${(readings.distance / 1000).toFixed(2)} km`);
    if (document.activeElement !== speed) speed.value = readings.speed_command * 3.6;
    if (document.activeElement !== steering) steering.value = -readings.steering_command * degrees;
    write("speedvalue", `${(readings.speed_command * 3.6).toFixed(0)} km/h`);
    write("steeringvalue", `${Math.abs(readings.steering_command * degrees).toFixed(1)}° ${readings.steering_command > 0.0009 ? "left" : readings.steering_command < -0.0009 ? "right" : ""}`);
    for (const [name, value] of Object.entries(readings.gains)) {
      const words = String(Number(value.toPrecision(4)));
      if (gains[name].value.textContent !== words) gains[name].value.textContent = words;
      if (document.activeElement !== gains[name].slider) gains[name].slider.value = value;
    }
    for (const [name, box] of Object.entries(boxes)) if (document.activeElement !== box) box.checked = readings.layers.includes(name);
  }

  // --- plots of the last seconds ---
  const span = 20, kept = [];
  let lined = true;
  let last = -1, drawn = 0;
  function remember(readings) {
    if (readings.time < last) kept.length = 0;
    if (readings.time === last) return;
    last = readings.time;
    kept.push([readings.time, readings.speed * 3.6, readings.setpoint * 3.6, readings.steering * degrees, readings.lateral ?? 0,
      ...readings.signals.map(value => value ?? 0)]);
    lined = readings.lateral !== null;
    while (kept[0][0] < last - span) kept.shift();
    if (performance.now() > drawn + (usual > 60 ? 500 : 100)) { drawn = performance.now(); plot(); }
  }
  const rows = [
    { words: "speed [km/h], set-point orange", lines: [[2, "#f5b455"], [1, "#1f6feb"]], least: 10, zero: true },
    { words: "steering angle [°], + left", lines: [[3, "#2b3747"]], least: 5 },
    { words: "cross-track error [m], + left", lines: [[4, "#0ca678"]], least: 0.5 },
  ];
  const canvas = get("plots"), pen = canvas.getContext("2d");

  // An inner signal, which the select chooses, is a row of its own.
  const inner = { words: "", lines: [[5, "#7048e8"]], least: 1e-6 }, chooser = get("signal");
  for (const [index, [name]] of about.signals.entries()) chooser.add(new Option(name, index));
  chooser.hidden = !about.signals.length;
  chooser.addEventListener("change", choose);
  function choose() {
    if (!about.signals.length) return;
    const [name, unit] = about.signals[chooser.value];
    inner.words = `${name.split(".").slice(-2).join(".")} [${unit || "-"}]`;
    inner.lines[0][0] = 5 + Number(chooser.value);
  }
  choose();
  function plot() {
    const shown = [...rows.slice(0, lined ? 3 : 2), ...(about.signals.length ? [inner] : [])];
    const width = 360, height = 44 * Math.max(shown.length, 3), high = 44, left = 30;
    if (canvas.height !== 2 * height) { canvas.height = 2 * height; canvas.style.height = `${height}px`; }
    pen.setTransform(2, 0, 0, 2, 0, 0);
    pen.clearRect(0, 0, width, height);
    pen.font = '10.5px system-ui, "DejaVu Sans", sans-serif';
    shown.forEach((row, number) => {
      const bottom = (number + 1) * high - 4, topmost = number * high + 13;
      const most = Math.max(row.least, ...kept.flatMap(one => row.lines.map(([key]) => Math.abs(one[key])))) * 1.05;
      const low = row.zero && kept.every(one => one[1] > -0.5) ? 0 : -most;
      const up = value => bottom - (value - low) / (most - low) * (bottom - topmost);
      pen.fillStyle = "#6b7a8a"; pen.textAlign = "left";
      pen.fillText(row.words, left + 2, topmost - 3);
      pen.textAlign = "right";
      if (!number) pen.fillText(`last ${span} s`, width - 2, topmost - 3);
      pen.fillText(most < 0.05 ? most.toExponential(0) : most.toFixed(most < 3 ? 1 : 0), left - 3, topmost + 7);
      pen.strokeStyle = "#dfe5ec"; pen.lineWidth = 1;
      pen.strokeRect(left, topmost, width - left - 1, bottom - topmost);
      if (low < 0) { pen.beginPath(); pen.moveTo(left, up(0)); pen.lineTo(width, up(0)); pen.stroke(); }
      for (const [key, colour] of row.lines) {
        pen.strokeStyle = colour; pen.lineWidth = 1.6;
        pen.beginPath();
        for (const one of kept) pen.lineTo(left + (width - left) * (1 - (last - one[0]) / span), up(one[key]));
        pen.stroke();
      }
    });
  }
  plot();
  centre();
  look(0);
  talk();
})();

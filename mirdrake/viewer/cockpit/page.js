(() => {
  const about = JSON.parse(document.getElementById("about").textContent);
  const get = id => document.getElementById(id);
  const page = Math.random().toString(36).slice(2);
  const degrees = 180 / Math.PI;
  get("what").textContent = `${about.vehicle} · ${about.world}`;

  // --- talking to the drive ---
  async function post(path, message) {
    const answer = await fetch(path, { method: "POST", body: JSON.stringify(message), keepalive: true,
      headers: { "Content-Type": "application/json", "X-Mirdrake-Token": about.token } });
    if (!answer.ok) throw new Error(`${path}: ${answer.status}`);
    return answer.json();
  }
  const order = message => post("/order", message).catch(() => {});

  // --- what hands do ---
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
    get("pad").textContent = pads.length ? "Game pad: left stick steers, right trigger faster, left trigger brakes, A stops, Start pauses, Back resets."
      : "Game pad: press a button of it to connect.";
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
  function hands() {
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
        const told = await post("/report", hands());
        silent = 0;
        show(told);
      } catch {
        if (++silent > 3) status("the drive has ended", "red");
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
    const [x, y, z] = views[number].eye;
    viewer.handle_command({ type: "set_transform", path: "/Cameras/default",
      matrix: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1] });
    viewer.handle_command({ type: "set_target", value: views[number].target });
    viewer.handle_command({ type: "set_property", path: "/Cameras/default/rotated/<object>", property: "position",
      value: [x, z, -y] });
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
  const layers = { driven: ["way driven", "#1a6bf2"], planned: ["planned line", "#0da64d"], lidar: ["lidar points", "#e8590c"],
    contacts: ["contacts", "#e61a26"], tyres: ["tyre forces", "#8c26d9"], friction: ["friction", "#c9a227"] };
  const boxes = {};
  for (const [name, [words, colour]] of Object.entries(layers)) {
    const label = document.createElement("label"), box = document.createElement("input"), mark = document.createElement("i");
    box.type = "checkbox";
    box.id = `layer-${name}`;
    mark.style.background = colour;
    label.append(box, mark, words);
    if (!about.layers.includes(name)) {
      box.disabled = true;
      mark.style.background = "#d5dbe3";
      label.className = "none";
      label.title = "this drive has none";
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
  if (!about.gains.length) get("gains").textContent = "none that can be changed while driving";
  get("given").onclick = () => {
    for (const [name, gain] of Object.entries(gains)) order({ do: "gain", name, value: gain.given });
    get("given").blur();
  };
  for (const name of ["reset", "pause", "record"]) get(name).onclick = () => { order({ do: name }); get(name).blur(); };
  get("fold").onclick = () => { get("side").classList.toggle("folded"); get("fold").blur(); };

  // --- gauges ---
  const from = -220, to = 40;  // degrees on the dial
  const top = Math.max(20, Math.ceil(about.forward * 3.6 / 20) * 20);
  const at = (angle, radius) => [100 + radius * Math.cos(angle / degrees), 92 + radius * Math.sin(angle / degrees)];
  function arc(a, b, radius) {
    const [x, y] = at(a, radius), [u, v] = at(b, radius);
    return `M${x} ${y}A${radius} ${radius} 0 ${b - a > 180 ? 1 : 0} 1 ${u} ${v}`;
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
  function status(words, kind) {
    get("state").textContent = words;
    get("state").className = `pill ${kind}`;
  }
  let note = "", noteUntil = 0;
  function show(told) {
    const kmh = told.speed * 3.6;
    const alarm = told.lost && told.message.startsWith("input lost");
    if (alarm) status("input lost", "red");
    else if (told.lost) status("press a key", "amber");
    else if (told.paused) status("paused", "amber");
    else status("driving", "");
    get("clock").textContent = `${told.time.toFixed(1)} s`;
    get("factor").textContent = told.factor === null ? "RTF –" : `RTF ${told.factor.toFixed(2)}`;
    get("factor").className = `pill ${told.factor !== null && told.factor < 0.95 ? "amber" : "quiet"}`;
    get("recording").hidden = !told.recording;
    get("record").textContent = told.recording ? "■ Stop" : "● Record";
    get("pause").textContent = told.paused ? "Go on" : "Pause";
    get("pause").classList.toggle("on", told.paused);
    if (told.message !== note) {
      note = told.message;
      noteUntil = performance.now() + 7000;
      get("note").textContent = note;
    }
    get("note").className = alarm ? "alarm" : "";
    get("note").hidden = !note || (!alarm && performance.now() > noteUntil);

    get("speed").textContent = Math.abs(kmh).toFixed(0);
    get("dialarc").setAttribute("d", arc(from, Math.max(angleOf(Math.abs(kmh)), from + 0.1), 80));
    const [x, y] = at(angleOf(Math.abs(told.wanted * 3.6)), 70), [u, v] = at(angleOf(Math.abs(told.wanted * 3.6)), 90);
    get("dialmark").setAttribute("d", `M${x} ${y}L${u} ${v}`);
    get("gear").textContent = told.wanted < -0.05 || kmh < -0.3 ? "R" : Math.abs(kmh) < 0.3 && told.wanted === 0 ? "N" : "D";
    get("rim").setAttribute("transform", `rotate(${-told.steering / about.steering * 135})`);
    get("angle").textContent = `${Math.abs(told.steering * degrees).toFixed(1)}° ${told.steering > 0.0009 ? "left" : told.steering < -0.0009 ? "right" : ""}`;
    if (told.lateral === null) get("lateral").textContent = "no line here";
    else {
      get("offset").setAttribute("x", 98 - Math.max(-1, Math.min(1, told.lateral / about.lane)) * 86);
      get("offset").setAttribute("fill", Math.abs(told.lateral) > about.lane ? "#e03131" : "#1f6feb");
      get("lateral").textContent = `${Math.abs(told.lateral).toFixed(2)} m ${told.lateral > 0.005 ? "left" : told.lateral < -0.005 ? "right" : ""}`;
    }
    get("distance").textContent = told.distance < 1000 ? `${told.distance.toFixed(0)} m` : `${(told.distance / 1000).toFixed(2)} km`;
    if (document.activeElement !== speed) speed.value = told.wanted * 3.6;
    if (document.activeElement !== steering) steering.value = -told.wanted_steering * degrees;
    get("speedvalue").textContent = `${(told.wanted * 3.6).toFixed(0)} km/h`;
    get("steeringvalue").textContent = `${Math.abs(told.wanted_steering * degrees).toFixed(1)}° ${told.wanted_steering > 0.0009 ? "left" : told.wanted_steering < -0.0009 ? "right" : ""}`;
    for (const [name, value] of Object.entries(told.gains)) {
      gains[name].value.textContent = Number(value.toPrecision(4));
      if (document.activeElement !== gains[name].slider) gains[name].slider.value = value;
    }
    for (const [name, box] of Object.entries(boxes)) if (document.activeElement !== box) box.checked = told.layers.includes(name);
    remember(told);
    document.body.dataset.told = JSON.stringify(told);
  }

  // --- plots of the last seconds ---
  const span = 20, kept = [];
  let last = -1, drawn = 0;
  function remember(told) {
    if (told.time < last) kept.length = 0;
    if (told.time === last) return;
    last = told.time;
    kept.push([told.time, told.speed * 3.6, told.setpoint * 3.6, told.steering * degrees, told.lateral ?? 0]);
    while (kept[0][0] < last - span) kept.shift();
    if (performance.now() > drawn + 100) { drawn = performance.now(); plot(); }
  }
  const rows = [
    { words: "speed [km/h]", lines: [[2, "#f5b455"], [1, "#1f6feb"]], least: 10, zero: true },
    { words: "steering [°], left up", lines: [[3, "#2b3747"]], least: 5 },
    { words: "off the line [m], left up", lines: [[4, "#0ca678"]], least: 0.5 },
  ];
  const canvas = get("plots"), pen = canvas.getContext("2d");
  function plot() {
    const width = 360, height = 132, high = height / 3, left = 30;
    pen.setTransform(2, 0, 0, 2, 0, 0);
    pen.clearRect(0, 0, width, height);
    pen.font = '10.5px system-ui, "DejaVu Sans", sans-serif';
    rows.forEach((row, number) => {
      const bottom = (number + 1) * high - 4, topmost = number * high + 13;
      const most = Math.max(row.least, ...kept.flatMap(one => row.lines.map(([key]) => Math.abs(one[key])))) * 1.05;
      const low = row.zero && kept.every(one => one[1] > -0.5) ? 0 : -most;
      const up = value => bottom - (value - low) / (most - low) * (bottom - topmost);
      pen.fillStyle = "#6b7a8a"; pen.textAlign = "left";
      pen.fillText(row.words, left + 2, topmost - 3);
      pen.textAlign = "right";
      pen.fillText(most.toFixed(most < 3 ? 1 : 0), left - 3, topmost + 7);
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
  look(0);
  talk();
})();

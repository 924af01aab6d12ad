// A looping replay of the machine (solid) and its simulations (lines). Drag to turn, arrow keys to turn, space to stop.
(() => {
  const canvas = document.getElementById("replay");
  if (!canvas) return;
  const data = JSON.parse(document.getElementById("replay-data").textContent);
  const decode = (packed) => new Float32Array(Uint8Array.from(atob(packed.bdata), (c) => c.charCodeAt(0)).buffer);
  const time = decode(data.time);
  const versions = Object.fromEntries(Object.entries(data.versions).map(([name, packed]) => [name, decode(packed)]));
  const count = versions.measured.length / data.frames / 3;
  const [tip, tool] = [count - 2, count - 1];
  const button = document.getElementById("replay-play");
  const slider = document.getElementById("replay-time");
  const label = document.getElementById("replay-label");
  const pen = canvas.getContext("2d");
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  let [frame, turn, tilt] = [0, -0.9, 0.35];
  let playing = !matchMedia("(prefers-reduced-motion: reduce)").matches;

  const point = (values, f, k) => [0, 1, 2].map((i) => values[3 * (f * count + k) + i]);
  const known = (p) => p.every(Number.isFinite);
  // Middle and size of all that is shown, so that nothing moves out of the picture.
  const [low, high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
  for (const values of Object.values(versions)) {
    values.forEach((value, i) => {
      if (!Number.isFinite(value)) return;
      low[i % 3] = Math.min(low[i % 3], value);
      high[i % 3] = Math.max(high[i % 3], value);
    });
  }
  const middle = low.map((value, i) => (value + high[i]) / 2);
  const size = Math.max(1e-3, Math.hypot(...low.map((value, i) => high[i] - value)));

  const project = ([x, y, z]) => {
    const [a, b, c] = [x - middle[0], y - middle[1], z - middle[2]];
    const [u, v] = [a * Math.cos(turn) - b * Math.sin(turn), a * Math.sin(turn) + b * Math.cos(turn)];
    const scale = 0.92 * Math.min(canvas.width, 1.15 * canvas.height) / size;
    return [canvas.width / 2 + scale * u, canvas.height / 2 - scale * (c * Math.cos(tilt) + v * Math.sin(tilt))];
  };

  const line = (points, width, stroke, dash = []) => {
    pen.beginPath();
    points.filter(known).map(project).forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    Object.assign(pen, { lineWidth: width, strokeStyle: stroke, lineCap: "round", lineJoin: "round" });
    pen.setLineDash(dash);
    pen.stroke();
    pen.setLineDash([]);
  };

  const machine = (name, f, width, stroke) => {
    const values = versions[name];
    const links = Array.from({ length: tip }, (_, k) => point(values, f, k));
    line([...links, point(values, f, tip)], width, stroke);
    const hanging = [point(values, f, tip), point(values, f, tool)];
    if (hanging.every(known)) {
      line(hanging, Math.max(1, width / 5), stroke);
      const [x, y] = project(hanging[1]);
      pen.beginPath();
      pen.arc(x, y, Math.max(3, width * 0.7), 0, 7);
      pen.fillStyle = stroke;
      pen.fill();
    }
  };

  const trail = (name, f, stroke) => {
    const end = known(point(versions[name], f, tool)) ? tool : tip;
    const past = Array.from({ length: Math.min(f + 1, Math.round(2 * data.rate)) }, (_, i) => point(versions[name], f - i, end));
    line(past, 1.2 * devicePixelRatio, stroke, [3 * devicePixelRatio, 3 * devicePixelRatio]);
  };

  const distance = (name, f) => {
    const end = [tool, tip].find((k) => known(point(versions[name], f, k)) && known(point(versions.measured, f, k)));
    if (end === undefined) return "";
    const [a, b] = [point(versions[name], f, end), point(versions.measured, f, end)];
    return `${end === tool ? "tool" : "tip"} ${name} ${(1000 * Math.hypot(...a.map((value, i) => value - b[i]))).toFixed(1)}\u202fmm off`;
  };

  const draw = () => {
    const scale = devicePixelRatio;
    [canvas.width, canvas.height] = [canvas.clientWidth * scale, canvas.clientHeight * scale];
    pen.clearRect(0, 0, canvas.width, canvas.height);
    const ground = (x, y) => [x, y, Math.min(0, low[2])];
    const step = size / 8;
    for (let i = -4; i <= 4; i += 1) {
      const [x, y] = [middle[0] + i * step, middle[1] + i * step];
      line([ground(x, middle[1] - 4 * step), ground(x, middle[1] + 4 * step)], scale, colour("faint"));
      line([ground(middle[0] - 4 * step, y), ground(middle[0] + 4 * step, y)], scale, colour("faint"));
    }
    machine("measured", frame, 9 * scale, colour("machine"));
    for (const name of Object.keys(versions).slice(1)) {
      trail(name, frame, colour(name));
      machine(name, frame, 2.4 * scale, colour(name));
    }
    slider.value = frame;
    label.textContent = [`${time[frame].toFixed(1)}\u202fs`, ...Object.keys(versions).slice(1).map((name) => distance(name, frame))]
      .filter(Boolean).join(" · ");
  };

  let [last, visible] = [0, true];
  const advance = (now) => {
    if (!playing || !visible) return;
    if (now - last >= 1000 / data.rate) {
      last = now;
      frame = (frame + 1) % data.frames;
      draw();
    }
    requestAnimationFrame(advance);
  };
  const play = (wanted) => {
    playing = wanted;
    button.textContent = playing ? "Stop" : "Play";
    if (playing) requestAnimationFrame(advance);
  };
  button.addEventListener("click", () => play(!playing));
  slider.max = data.frames - 1;
  slider.addEventListener("input", () => { play(false); frame = Number(slider.value); draw(); });
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (!event.buttons) return;
    turn += event.movementX / 150;
    tilt = Math.min(1.5, Math.max(-0.2, tilt + event.movementY / 150));
    draw();
  });
  canvas.addEventListener("keydown", (event) => {
    const change = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
    if (event.key === " ") play(!playing);
    if (change) [turn, tilt] = [turn + change[0], Math.min(1.5, Math.max(-0.2, tilt + change[1]))];
    if (event.key === " " || change) { event.preventDefault(); draw(); }
  });
  // It moves only while it is in view.
  new IntersectionObserver(([entry]) => { visible = entry.isIntersecting; if (visible && playing) requestAnimationFrame(advance); }).observe(canvas);
  addEventListener("resize", draw);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  draw();
  play(playing);
})();

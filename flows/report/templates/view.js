"use strict";
// Moves the arm along its log, with the time in step with the curves and the values.
(() => {
  const told = JSON.parse(document.getElementById("scene").textContent);
  const bytes = (packed) =>
    Uint8Array.from(atob(packed.bdata), (c) => c.charCodeAt(0)).buffer;
  const floats = (packed) => new Float32Array(bytes(packed));
  const motion = Object.fromEntries(
    Object.entries(told.motion).map(([key, value]) => [key, floats(value)]),
  );
  const dof = told.arm.joints.length;
  const last = motion.t[motion.t.length - 1];
  // The largest residual of each joint, from which its ball is all orange.
  const worst = Array.from({ length: dof }, (_, j) => {
    let most = 1e-9;
    for (let i = j; i < motion.tau.length; i += dof)
      most = Math.max(most, Math.abs(motion.tau[i]), Math.abs(motion.hat[i]));
    return most;
  });

  function build() {
    const test = document.createElement("canvas");
    if (!test.getContext("webgl2") && !test.getContext("webgl")) return null;
    const stage = document.querySelector(".stage");
    stage.textContent = "";
    const viewer = new MeshCat.Viewer(stage);
    const three = MeshCat.THREE;
    stage.parentElement.querySelector(".dg")?.remove();
    viewer.set_property(["Background"], "top_color", [0.97, 0.98, 0.99]);
    viewer.set_property(["Background"], "bottom_color", [0.86, 0.89, 0.92]);
    const size = told.arm.size;
    viewer.set_property(["Grid"], "visible", size < 8);
    // By itself it takes the height of the window.
    const resize = viewer.set_3d_pane_size.bind(viewer);
    const fit = () => resize(stage.clientWidth, stage.clientHeight);
    viewer.set_3d_pane_size = fit;
    new ResizeObserver(fit).observe(stage);
    const base = new three.Group();
    viewer.scene.add(base); // whose z is up
    const frames = [base];
    for (const joint of told.arm.joints) {
      const fixed = new three.Group();
      new three.Matrix4()
        .fromArray(joint.place)
        .decompose(fixed.position, fixed.quaternion, fixed.scale);
      const turning = new three.Group();
      fixed.add(turning);
      frames[frames.length - 1].add(fixed);
      frames.push(turning);
    }
    const metal = new three.MeshPhongMaterial({ color: 0x9fb3c4, flatShading: true });
    for (const body of told.arm.bodies) {
      const shape = new three.Mesh(geometry(three, body), metal);
      new three.Matrix4()
        .fromArray(body.place)
        .decompose(shape.position, shape.quaternion, shape.scale);
      if (body.kind === "cylinder") shape.rotateX(Math.PI / 2); // its own is along y
      frames[body.joint].add(shape);
    }
    const balls = frames.slice(1).map((frame) => {
      const look = new three.MeshPhongMaterial({ color: 0xffffff, depthTest: false });
      const ball = new three.Mesh(new three.SphereGeometry(0.032 * size, 24, 16), look);
      look.transparent = true;
      look.opacity = 0.92;
      ball.renderOrder = 2;
      frame.add(ball);
      return ball;
    });
    viewer.camera.position.set(0.75 * size, 0.65 * size, 0.75 * size);
    viewer.controls.target.set(0, 0.4 * size, 0);
    fit();
    return { viewer, frames, balls, three };
  }

  function geometry(three, body) {
    if (body.kind === "box") return new three.BoxGeometry(...body.size);
    if (body.kind === "sphere") return new three.SphereGeometry(body.size[0], 24, 16);
    if (body.kind === "cylinder") {
      const [radius, length] = body.size;
      return new three.CylinderGeometry(radius, radius, length, 28);
    }
    const made = new three.BufferGeometry();
    made.setAttribute("position", new three.BufferAttribute(floats(body.points), 3));
    made.setIndex(new three.BufferAttribute(new Uint32Array(bytes(body.faces)), 1));
    made.computeVertexNormals();
    return made;
  }

  const arm = build();
  const slider = document.getElementById("time");
  const clock = document.getElementById("clock");
  const play = document.getElementById("play");
  const rows = [...document.querySelectorAll(".bars tbody tr")];
  const sheets = [...document.querySelectorAll("#sheet figure")];
  const line = document.createElement("div");
  line.className = "now";
  document.getElementById("sheet").append(line);
  slider.max = last;
  let now = 0;
  let chosen = 0;
  let playing = 0;

  function place(t) {
    // The last pose that is not later, and how far to the next.
    let low = 0;
    let high = motion.t.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (motion.t[middle] <= t) low = middle;
      else high = middle;
    }
    const span = motion.t[high] - motion.t[low];
    return [low, high, span > 0 ? Math.min(1, (t - motion.t[low]) / span) : 0];
  }

  function show(t) {
    now = Math.min(Math.max(t, 0), last);
    slider.value = now;
    clock.value = `${now.toFixed(2)} of ${last.toFixed(1)} s`;
    const [low, high, part] = place(now);
    const at = (key, j) =>
      (1 - part) * motion[key][low * dof + j] + part * motion[key][high * dof + j];
    for (let j = 0; j < dof; j += 1) {
      const [q, tau, hat] = ["q", "tau", "hat"].map((key) => at(key, j));
      const share = Math.min(1, Math.abs(tau - hat) / worst[j]);
      const cells = rows[j].querySelectorAll("td");
      cells[0].textContent = ((q * 180) / Math.PI).toFixed(1);
      cells[1].textContent = tau.toPrecision(3);
      cells[2].textContent = hat.toPrecision(3);
      rows[j].querySelector(".bar").style.width = `${Math.min(100, 500 * share).toFixed(1)}%`;
      if (!arm) continue;
      const axis = new arm.three.Vector3(...told.arm.joints[j].axis);
      arm.frames[j + 1].quaternion.setFromAxisAngle(axis, q);
      // From white to vermilion, all of it from a fifth of the largest torque on.
      const heat = Math.min(1, 5 * share);
      arm.balls[j].material.color.setRGB(1 - 0.17 * heat, 1 - 0.63 * heat, 1 - heat);
    }
    arm?.viewer.set_dirty();
    mark();
  }

  function mark() {
    const box = sheets[chosen].querySelector(".plot");
    const layout = box._fullLayout;
    if (!layout?.xaxis) return;
    const inside = layout.xaxis.l2p(now);
    const seen = inside >= 0 && inside <= layout.xaxis._length;
    line.style.left = seen ? `${box.offsetLeft + layout.xaxis._offset + inside}px` : "-9px";
    line.style.top = `${box.offsetTop + layout._size.t}px`;
    line.style.height = `${layout._size.h}px`;
  }

  function choose(joint) {
    chosen = joint;
    sheets.forEach((sheet, j) => (sheet.hidden = j !== joint));
    rows.forEach((row, j) => row.classList.toggle("chosen", j === joint));
    const box = sheets[joint].querySelector(".plot");
    // Drawn by the page's script when it comes into sight: then it can be clicked.
    const wait = setInterval(() => {
      if (!box._fullLayout?.xaxis) return;
      clearInterval(wait);
      if (!box.dataset.clicked) {
        box.dataset.clicked = "yes";
        box.on("plotly_click", (event) => show(event.points[0].x));
        box.on("plotly_relayout", mark);
        box.on("plotly_afterplot", mark);
      }
      mark();
    }, 60);
  }

  function step(before) {
    return (stamp) => {
      if (!playing) return;
      const speed = Number(document.getElementById("speed").value);
      const next = now + (speed * (stamp - (before ?? stamp))) / 1000;
      show(next > last ? 0 : next);
      requestAnimationFrame(step(stamp));
    };
  }

  play.addEventListener("click", () => {
    playing = playing ? 0 : 1;
    play.textContent = playing ? "Pause" : "Play";
    if (playing) requestAnimationFrame(step(null));
  });
  slider.addEventListener("input", () => show(Number(slider.value)));
  rows.forEach((row, j) => row.addEventListener("click", () => choose(j)));
  choose(told.first);
  show(0);
})();

// Renderer, light, ground and camera; draws only if something has changed.

import {
  BufferGeometry, Color, DirectionalLight, Float32BufferAttribute, Fog, Group, HemisphereLight, LineBasicMaterial, LineSegments, Mesh, MeshBasicMaterial, PCFShadowMap, PerspectiveCamera, PlaneGeometry, Scene,
  ShaderMaterial, ShadowMaterial, Vector3, VSMShadowMap, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";

const THEMES = {
  dark: { sky: 0x15181e, ground: 0x1c2027, line: 0x3a414d, bold: 0x667184, shadow: 0.5, hemi: 0.95, key: 2.9, rim: 1.6 },
  light: { sky: 0xeef1f5, ground: 0xe3e7ed, line: 0xb4bdc9, bold: 0x76839a, shadow: 0.28, hemi: 1.35, key: 2.6, rim: 0.7 },
};
const SUN = new Vector3(1.7, 5.6, 2.2);
const TOO_SLOW = 70; // ms between pictures
const BOLD = 5; // metres between bold lines
const LEAST_SHARP = 0.45; // least resolution, as a share of the full one
const SHADOW_REACH = 1.7; // metres around the hips within which a figure's shadow falls

export class Stage {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.plain = drawsInSoftware();
    this.sharpness = 1;
    this.renderer = new WebGLRenderer({ canvas, antialias: !this.plain, powerPreference: "high-performance" });
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = this.plain ? PCFShadowMap : VSMShadowMap;
    this.scene = new Scene();
    this.scene.background = new Color();
    this.scene.fog = new Fog(0, 12, 60);
    this.camera = new PerspectiveCamera(35, 1, 0.15, 300);
    this.controls = new OrbitControls(this.camera, canvas);
    Object.assign(this.controls, { enableDamping: true, dampingFactor: 0.15, minDistance: 0.6, maxDistance: 120 });
    this.controls.maxPolarAngle = Math.PI * 0.495;
    this.controls.addEventListener("change", () => this.invalidate());
    this.#lights();
    this.#ground();
    this.frames = 0;
    this.dirty = true;
    canvas.addEventListener("webglcontextrestored", () => this.invalidate());
    new ResizeObserver(() => this.resize()).observe(canvas.parentElement);
    this.resize();
    this.theme = matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark";
  }

  invalidate() {
    this.dirty = true;
  }

  resize() {
    const { clientWidth, clientHeight } = this.canvas.parentElement;
    this.renderer.setPixelRatio(this.plain ? this.sharpness : Math.min(window.devicePixelRatio, 2));
    this.renderer.setSize(Math.max(1, clientWidth), Math.max(1, clientHeight), false);
    this.camera.aspect = Math.max(1, clientWidth) / Math.max(1, clientHeight);
    this.camera.updateProjectionMatrix();
    this.invalidate();
  }

  flipTheme() {
    this.theme = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
  }

  set theme(name) {
    document.documentElement.dataset.theme = name;
    const theme = THEMES[name];
    this.scene.background.set(theme.sky);
    this.scene.fog.color.set(theme.sky);
    for (const [part, color] of Object.entries(this.colors)) color.set(theme[part]);
    this.shade.material.opacity = theme.shadow;
    this.hemi.intensity = theme.hemi;
    this.hemi.groundColor.set(theme.ground);
    this.key.intensity = theme.key;
    this.rim.intensity = theme.rim;
    this.invalidate();
  }

  /** Moves the camera's target to a point, and the camera with it. */
  follow(x, y, z) {
    const { target } = this.controls;
    const [dx, dy, dz] = [x - target.x, y - target.y, z - target.z];
    if (Math.abs(dx) + Math.abs(dy) + Math.abs(dz) < 1e-6) return;
    target.set(x, y, z);
    this.camera.position.x += dx;
    this.camera.position.y += dy;
    this.camera.position.z += dz;
    this.invalidate();
  }

  /** Looks at a point from a direction (angle in the ground plane, from +Z towards +X) and a distance. */
  look(target, angle, lift, distance) {
    this.controls.target.copy(target);
    this.camera.position.set(
      target.x + distance * Math.cos(lift) * Math.sin(angle),
      target.y + distance * Math.sin(lift),
      target.z + distance * Math.cos(lift) * Math.cos(angle),
    );
    this.controls.update();
    this.invalidate();
  }

  /** Draws if anything has changed since the last call; returns whether it did. */
  draw() {
    this.controls.update();
    if (!this.dirty) return false;
    this.dirty = false;
    if (this.plain) this.#keepUp(performance.now());
    const { target } = this.controls;
    const distance = this.camera.position.distanceTo(target);
    this.scene.fog.near = 8 + distance;
    this.scene.fog.far = 40 + 5 * distance;
    // Move the grid in whole periods, so that its lines stay fixed in the world.
    this.grid.position.set(BOLD * Math.round(target.x / BOLD), 0, BOLD * Math.round(target.z / BOLD));
    if (!this.plain) this.grid.material.uniforms.far.value = this.scene.fog.far;
    this.renderer.render(this.scene, this.camera);
    this.frames += 1;
    return true;
  }

  // Lowers the resolution if consecutive pictures take too long.
  #keepUp(now) {
    const passed = now - (this.drawnAt ?? -Infinity);
    this.drawnAt = now;
    this.slow = passed > TOO_SLOW && passed < 10 * TOO_SLOW ? (this.slow ?? 0) + 1 : 0;
    if (this.slow < 5 || this.sharpness <= LEAST_SHARP) return;
    this.slow = 0;
    this.sharpness *= 0.75;
    this.resize();
    this.dirty = false;
  }

  /** Sets the figures' positions, [x, z, x, z, ...], so that their shadows are as sharp as possible. */
  shadowsAt(places) {
    const [xs, zs] = [0, 1].map((axis) => places.filter((_, i) => i % 2 === axis));
    const [left, right, back, front] = [Math.min(...xs), Math.max(...xs), Math.min(...zs), Math.max(...zs)];
    const reach = SHADOW_REACH + Math.max(right - left, front - back) / 2;
    this.key.target.position.set((left + right) / 2, 0, (back + front) / 2);
    this.key.position.copy(this.key.target.position).addScaledVector(SUN, 0.6 * reach);
    this.shade.position.x = this.key.target.position.x;
    this.shade.position.z = this.key.target.position.z;
    const box = this.key.shadow.camera;
    if (Math.abs(box.right - reach) < 0.02 * reach) return;
    Object.assign(box, { left: -reach, right: reach, top: reach, bottom: -reach, far: 8 * reach });
    box.updateProjectionMatrix();
    this.shade.scale.setScalar(reach / 200); // no larger than the shadows
  }

  #lights() {
    this.hemi = new HemisphereLight(0xffffff, 0x888888, 1);
    this.key = new DirectionalLight(0xfff3e4, 1);
    this.key.castShadow = true;
    const { shadow } = this.key;
    shadow.mapSize.setScalar(this.plain ? 384 : 1024);
    shadow.radius = this.plain ? 2.5 : 5;
    shadow.blurSamples = 12;
    shadow.bias = -0.0006;
    this.rim = new DirectionalLight(0xa9c4ff, 1);
    this.rim.position.set(-3, 3, -4);
    this.scene.add(this.hemi, this.key, this.key.target, this.rim);
  }

  #ground() {
    const plane = new PlaneGeometry(400, 400).rotateX(-Math.PI / 2);
    this.colors = { ground: new Color(), line: new Color(), bold: new Color(), sky: new Color() };
    this.grid = this.plain ? this.#plainGrid(plane) : new Mesh(plane, gridMaterial(this.colors));
    this.shade = new Mesh(plane, new ShadowMaterial());
    this.shade.receiveShadow = true;
    this.shade.position.y = 0.002;
    this.grid.renderOrder = -2;
    this.shade.renderOrder = -1;
    this.shade.material.depthWrite = false;
    this.scene.add(this.grid, this.shade);
  }

  // A grid of lines: without a graphics card, a shader for every ground pixel would take most of the time.
  #plainGrid(plane) {
    const floor = new Mesh(plane, new MeshBasicMaterial({ depthWrite: false }));
    const lines = new LineSegments(gridLines(24, 2), new LineBasicMaterial({ depthWrite: false, vertexColors: true, transparent: true }));
    const bold = new LineSegments(boldLines(45, 3), new LineBasicMaterial({ depthWrite: false, transparent: true }));
    Object.assign(this.colors, { ground: floor.material.color, line: lines.material.color, bold: bold.material.color });
    [floor, lines, bold].forEach((part, n) => (part.renderOrder = [-3, -2, -1.5][n]));
    return new Group().add(floor, lines, bold);
  }
}

// Whether there is no graphics card; edges and shadows are coarser then.
function drawsInSoftware() {
  const context = document.createElement("canvas").getContext("webgl2");
  if (!context) throw new Error("WebGL is not available");
  const details = context.getExtension("WEBGL_debug_renderer_info");
  const name = context.getParameter(details ? details.UNMASKED_RENDERER_WEBGL : context.RENDERER);
  context.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software|basic render/i.test(name);
}

// Lines every metre, up to `reach`, in short pieces: software renderers lose lines that reach behind the camera. They
// fade with distance, where they would flicker.
function gridLines(reach, piece) {
  const points = [];
  for (let n = -reach; n <= reach; n++) {
    for (let at = -reach; at < reach; at += piece) {
      points.push(n, 0, at, n, 0, at + piece, at, 0, n, at + piece, 0, n);
    }
  }
  const colors = [];
  for (let i = 0; i < points.length; i += 3) colors.push(1, 1, 1, Math.min(1, Math.max(0, 1.5 - (1.5 * Math.hypot(points[i], points[i + 2])) / reach)));
  return new BufferGeometry().setAttribute("position", new Float32BufferAttribute(points, 3)).setAttribute("color", new Float32BufferAttribute(colors, 4));
}

// Every fifth line as a thin band, because lines are always one pixel wide.
function boldLines(reach, piece) {
  const points = [];
  for (let n = -reach; n <= reach; n += BOLD) {
    for (let at = -reach; at < reach; at += piece) {
      for (const side of [-0.006, 0, 0.006]) points.push(n + side, 0, at, n + side, 0, at + piece, at, 0, n + side, at + piece, 0, n + side);
    }
  }
  return new BufferGeometry().setAttribute("position", new Float32BufferAttribute(points, 3));
}

// Lines every metre, bold every five, finer every quarter, over squares in two shades; one pixel wide at any distance,
// fading out.
function gridMaterial({ ground, line, bold, sky }) {
  return new ShaderMaterial({
    uniforms: { ground: { value: ground }, line: { value: line }, bold: { value: bold }, sky: { value: sky }, far: { value: 60 } },
    depthWrite: false, // drawn first, so that marks on the ground never compete with it for depth
    vertexShader: `
      varying vec3 world;
      void main() {
        world = (modelMatrix * vec4(position, 1.0)).xyz;
        gl_Position = projectionMatrix * viewMatrix * vec4(world, 1.0);
      }`,
    fragmentShader: `
      uniform vec3 ground, line, bold, sky;
      uniform float far;
      varying vec3 world;
      float lines(vec2 at, float width) {
        vec2 pixel = fwidth(at);
        vec2 near = abs(fract(at - 0.5) - 0.5);
        vec2 on = (1.0 - smoothstep(pixel * width * 0.5, pixel * (width * 0.5 + 1.0), near)) * (1.0 - smoothstep(0.15, 0.5, pixel));
        return max(on.x, on.y);
      }
      void main() {
        float away = distance(world, cameraPosition);
        float whole = lines(world.xz, 1.2);
        float parts = lines(world.xz * 4.0, 0.6) * 0.22;
        float fifth = lines(world.xz / ${BOLD.toFixed(1)}, 2.2);
        vec2 square = step(0.5, fract(world.xz * 0.5));
        vec3 shade = mix(ground, line, 0.10 * abs(square.x - square.y) * (1.0 - smoothstep(0.1, 0.35, away / far)));
        vec3 color = mix(mix(shade, line, max(whole * 0.85, parts)), bold, fifth * 0.8);
        color = mix(color, sky, smoothstep(0.1 * far, 0.55 * far, away));
        gl_FragColor = vec4(color, 1.0);
        #include <colorspace_fragment>
      }`,
  });
}

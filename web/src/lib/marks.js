// Marks on the ground: paths as ribbons, footprints as discs.

import {
  BufferAttribute, BufferGeometry, CircleGeometry, Color, DoubleSide, Group, InstancedMesh, Matrix4,
  Mesh, MeshBasicMaterial, RingGeometry,
} from "three";

const matrix = new Matrix4();
export const CONTACT_COLORS = { left: 0x3b82f6, right: 0xf97316, "": 0x78716c };
export const SLIDE_COLOR = 0xe6176f;

/** A flat band along points x, z; `shown` limits it to the first points. */
export class Ribbon extends Mesh {
  constructor(points, color, { width = 0.02, height = 0.004, opacity = 1, dash = 0 } = {}) {
    const material = new MeshBasicMaterial({ color, transparent: true, opacity, side: DoubleSide, depthWrite: false });
    super(new BufferGeometry(), material);
    this.width = width;
    this.height = height;
    this.dash = dash;
    this.frustumCulled = false;
    this.points = points;
  }

  /** Sets the points: any array of x, z in metres. */
  set points(points) {
    const count = points.length / 2;
    const corners = new Float32Array(count * 6);
    let [nx, nz] = [1, 0];
    const index = [];
    let arc = 0;
    for (let i = 0; i < count; i++) {
      const a = Math.max(0, i - 1) * 2;
      const b = Math.min(count - 1, i + 1) * 2;
      const [dx, dz] = [points[b] - points[a], points[b + 1] - points[a + 1]];
      const length = Math.hypot(dx, dz);
      if (length > 1e-6) [nx, nz] = [-dz / length, dx / length];
      const [x, z, half] = [points[i * 2], points[i * 2 + 1], this.width / 2];
      corners.set([x - nx * half, this.height, z - nz * half, x + nx * half, this.height, z + nz * half], i * 6);
      if (i === 0) continue;
      arc += Math.hypot(x - points[i * 2 - 2], z - points[i * 2 - 1]);
      if (this.dash && Math.floor(arc / this.dash) % 2) continue;
      const v = i * 2;
      index.push(v - 2, v - 1, v, v - 1, v + 1, v);
    }
    this.geometry.dispose();
    this.geometry = new BufferGeometry();
    this.geometry.setAttribute("position", new BufferAttribute(corners, 3));
    this.geometry.setIndex(index);
  }

  /** Limits the band to its first frames, if it has no dashes. */
  set shown(count) {
    this.geometry.setDrawRange(0, Math.max(0, (count - 1) * 6));
  }
}

/** A clip's footprints: where a foot is low, in its side's colour, and where it slides. */
export class Footprints extends Group {
  /** @param {import("./clip.js").Clip} clip */
  constructor(clip) {
    super();
    const marks = [];
    for (const foot of clip.feet) {
      let last = null;
      for (let frame = 0; frame < clip.frames; frame++) {
        if (!foot.low[frame]) continue;
        const [x, z] = [foot.track[frame * 3], foot.track[frame * 3 + 2]];
        const slides = foot.slides[frame];
        // One mark per standing foot, not hundreds.
        if (last && !slides && !last.slides && Math.hypot(x - last.x, z - last.z) < 0.015) continue;
        last = { x, z, slides };
        marks.push([x, z, slides ? SLIDE_COLOR : CONTACT_COLORS[foot.side], slides ? 0.012 : 0.022]);
      }
    }
    const disc = new CircleGeometry(1, 14).rotateX(-Math.PI / 2);
    const material = new MeshBasicMaterial({ transparent: true, opacity: 0.55, depthWrite: false });
    this.marks = new InstancedMesh(disc, material, Math.max(1, marks.length));
    this.marks.count = marks.length;
    marks.forEach(([x, z, color, radius], n) => {
      this.marks.setMatrixAt(n, matrix.makeScale(radius, 1, radius).setPosition(x, 0.005, z));
      this.marks.setColorAt(n, new Color(color));
    });
    this.marks.frustumCulled = false;
    this.add(this.marks);
    this.live = clip.feet.map((foot) => {
      const ring = new Mesh(
        new RingGeometry(0.075, 0.1, 32).rotateX(-Math.PI / 2),
        new MeshBasicMaterial({ transparent: true, opacity: 0.9, depthWrite: false }),
      );
      ring.frustumCulled = false;
      this.add(ring);
      return { foot, ring };
    });
  }

  /** Draws rings around the feet in contact in this frame. */
  setFrame(frame) {
    for (const { foot, ring } of this.live) {
      ring.visible = Boolean(foot.low[frame]);
      ring.position.set(foot.track[frame * 3], 0.006, foot.track[frame * 3 + 2]);
      ring.material.color.set(foot.slides[frame] ? SLIDE_COLOR : CONTACT_COLORS[foot.side]);
    }
  }
}

// The part in 3D: grey the part, in colours what was added and removed, cut at the layer that is shown.
import {
  AmbientLight, BufferAttribute, BufferGeometry, Box3, Color, DataTexture, DirectionalLight, DoubleSide, HemisphereLight,
  Mesh, MeshBasicMaterial, MeshLambertMaterial, NearestFilter, PerspectiveCamera, Plane, PlaneGeometry, RGBAFormat, Scene,
  SRGBColorSpace, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { bodyOf } from "./codec.js";
import { colour } from "./layer.js";

const DIRECTIONS = { corner: [0.55, -1.1, 0.75], top: [0, -0.0001, 1], front: [0, -1, 0] };
const shade = (name) => new Color().setRGB(...colour(name).map((value) => value / 255), SRGBColorSpace);

export class View {
  // Throws where there is no WebGL.
  constructor(canvas, meta, image) {
    Object.assign(this, { canvas, meta, image, materials: {}, meshes: {}, asked: false, triangles: 0 });
    this.renderer = new WebGLRenderer({ canvas, antialias: true, preserveDrawingBuffer: true });
    this.renderer.localClippingEnabled = true;
    this.scene = new Scene();
    this.camera = new PerspectiveCamera(32, 1, 0.01, 100000);
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.addEventListener("change", () => this.draw());
    this.plane = new Plane(new Vector3(0, 0, -1), 0);
    this.sun = new DirectionalLight(0xffffff, 1.7);
    this.scene.add(new HemisphereLight(0xffffff, 0x6a727a, 1.5), new AmbientLight(0xffffff, 0.35), this.sun);
    this.box = new Box3();
    this.sectioned = true;
    const { width, height, pixel_mm: [px, py], corner_mm: [x, y] } = meta.frame;
    this.texture = new DataTexture(image.data, width, height, RGBAFormat);
    this.texture.magFilter = this.texture.minFilter = NearestFilter;
    this.texture.colorSpace = SRGBColorSpace;
    this.texture.flipY = false;
    const face = new PlaneGeometry(width * px, height * py);
    const uv = face.attributes.uv; // rows of the image go from the back to the front
    for (let i = 0; i < uv.count; i++) uv.setY(i, 1 - uv.getY(i));
    this.cap = new Mesh(face, new MeshBasicMaterial({ map: this.texture, alphaTest: 0.5, side: DoubleSide }));
    this.cap.position.set(x + (width * px) / 2, y - (height * py) / 2, 0);
    this.scene.add(this.cap);
    canvas.addEventListener("keydown", (event) => this.key(event));
  }

  async load() {
    for (const [name, known] of Object.entries(this.meta.bodies)) {
      const { positions, index } = await bodyOf(`body_${name}`, known), geometry = new BufferGeometry();
      geometry.setAttribute("position", new BufferAttribute(positions, 3));
      geometry.setIndex(new BufferAttribute(index, 1));
      geometry.computeBoundingBox();
      this.box.union(geometry.boundingBox);
      this.triangles += known.faces;
      const material = new MeshLambertMaterial({ flatShading: true, side: DoubleSide, clippingPlanes: [this.plane] });
      // What was added lies on the part: it is drawn a little nearer.
      if (name !== "part") Object.assign(material, { polygonOffset: true, polygonOffsetFactor: -2, polygonOffsetUnits: -2 });
      this.materials[name] = material;
      this.meshes[name] = new Mesh(geometry, material);
      this.scene.add(this.meshes[name]);
    }
    this.paint();
    this.look("corner");
  }

  paint() {
    for (const [name, material] of Object.entries(this.materials)) material.color = shade(`--${name}`);
    this.draw();
  }

  look(name) {
    const middle = this.box.getCenter(new Vector3()), size = this.box.getSize(new Vector3()).length() || 1;
    const way = new Vector3(...DIRECTIONS[name]).normalize();
    // As far away as all of the ball around the part is seen, whichever side of the view is the shorter.
    const { width, height } = this.canvas.getBoundingClientRect();
    const half = Math.atan(Math.tan((this.camera.fov * Math.PI) / 360) * Math.min(width / height || 1, 1));
    this.controls.target.copy(middle);
    this.camera.position.copy(middle).addScaledVector(way, (1.1 * size) / 2 / Math.sin(half));
    this.camera.near = size / 500;
    this.camera.far = size * 20;
    this.controls.update();
    this.draw();
  }

  lookAt(box, z) {
    const [left, bottom, right, top] = box, target = new Vector3((left + right) / 2, (bottom + top) / 2, z);
    const away = this.camera.position.clone().sub(this.controls.target);
    const size = this.box.getSize(new Vector3()).length();
    away.setLength(Math.max(Math.max(right - left, top - bottom) * 6, size * 0.35));
    this.controls.target.copy(target);
    this.camera.position.copy(target).add(away);
    this.controls.update();
    this.draw();
  }

  at(z) {
    this.plane.constant = this.sectioned ? z : 1e9;
    this.cap.position.z = z;
    this.cap.visible = this.sectioned;
    this.texture.needsUpdate = true;
    this.draw();
  }

  mode(mode) {
    const show = { before: ["part", "removed"], after: ["part", "added"], difference: ["part", "added", "removed"] }[mode];
    for (const [name, mesh] of Object.entries(this.meshes)) mesh.visible = show.includes(name);
    if (this.materials.added) this.materials.added.color = shade(mode === "after" ? "--part" : "--added");
    if (this.materials.removed) this.materials.removed.color = shade(mode === "before" ? "--part" : "--removed");
    this.draw();
  }

  opacity(share) {
    const material = this.materials.part;
    if (!material) return;
    Object.assign(material, { transparent: share < 1, opacity: share, depthWrite: share === 1, needsUpdate: true });
    this.meshes.part.visible = share > 0;
    this.draw();
  }

  key(event) {
    if (event.shiftKey || !"+-=".includes(event.key) && !event.key.startsWith("Arrow")) return;
    const away = this.camera.position.clone().sub(this.controls.target), up = new Vector3(0, 0, 1);
    if (event.key === "ArrowLeft" || event.key === "ArrowRight") away.applyAxisAngle(up, event.key === "ArrowLeft" ? -0.15 : 0.15);
    else if ("+=".includes(event.key)) away.multiplyScalar(0.87);
    else if (event.key === "-") away.multiplyScalar(1.15);
    else return; // up and down go through the layers
    event.preventDefault();
    event.stopPropagation();
    this.camera.position.copy(this.controls.target).add(away);
    this.controls.update();
    this.draw();
  }

  // Once for each frame of the browser, however often it is asked for.
  draw() {
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame(() => {
      this.asked = false;
      const { width, height } = this.canvas.getBoundingClientRect();
      this.renderer.setPixelRatio(devicePixelRatio);
      this.renderer.setSize(width, height, false);
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
      this.scene.background = shade("--void");
      this.sun.position.copy(this.camera.position);
      this.renderer.render(this.scene, this.camera);
      this.drawn = (this.drawn || 0) + 1;
    });
  }
}

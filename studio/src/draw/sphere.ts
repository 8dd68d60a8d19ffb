/** Panorama and heat on a canvas with WebGL 2, from inside the sphere or flat. Marks are drawn over it elsewhere. */

import type { Heat, Window } from "../math/heat";
import { IDENTITY, type Matrix } from "../math/rotation";
import { heatColours, lookColours } from "./palette";

const VERTEX = `#version 300 es
in vec2 corner;
out vec2 at;
void main() { at = corner; gl_Position = vec4(corner, 0.0, 1.0); }`;

// `flat` pixels are azimuth and elevation, the others rays through the image plane x = 1.
const FRAGMENT = `#version 300 es
precision highp float;
in vec2 at;
out vec4 colour;
uniform bool isFlat, hasPanorama, hasFine;
uniform vec2 plane, lens; // lens: half extents of an ordinary picture, 0 for a panorama
uniform mat3 panorama_R_view, belief_R_view;
uniform float heat, muted;
uniform vec4 window;
uniform sampler2D panorama, coarse, fine, palette;
const float PI = 3.14159265358979;
vec2 place(vec3 d) { return vec2(0.5 - atan(d.y, d.x) / (2.0 * PI), 0.5 - asin(clamp(d.z, -1.0, 1.0)) / PI); }
void main() {
  vec3 ray;
  if (isFlat) {
    float azimuth = -at.x * PI, elevation = at.y * PI / 2.0;
    ray = vec3(cos(elevation) * cos(azimuth), cos(elevation) * sin(azimuth), sin(elevation));
  } else ray = normalize(vec3(1.0, -at.x * plane.x, at.y * plane.y));
  vec3 ground;
  vec3 seen = panorama_R_view * ray;
  vec2 part = lens.x > 0.0 ? vec2(seen.y, seen.z) / max(seen.x, 1e-6) / lens : vec2(0.0);
  if (hasPanorama && seen.x * lens.x >= 0.0 && max(abs(part.x), abs(part.y)) <= 1.0) {
    ground = texture(panorama, lens.x > 0.0 ? 0.5 - 0.5 * part : place(seen)).rgb;
    float grey = dot(ground, vec3(0.3333));
    ground = mix(ground, mix(vec3(grey), ground, 0.75) * 0.82, muted);
  } else ground = mix(vec3(0.12, 0.135, 0.165), vec3(0.165, 0.18, 0.215), smoothstep(-0.6, 0.9, ray.z));
  if (heat > 0.0) {
    vec2 where = place(belief_R_view * ray);
    float share = texture(coarse, where).r;
    if (hasFine) {
      float across = window.x - (0.5 - where.x) * 2.0 * PI;
      across -= floor(across / (2.0 * PI)) * 2.0 * PI;
      vec2 inside = vec2(across, window.z - (0.5 - where.y) * PI) / vec2(window.x - window.y, window.z - window.w);
      if (inside.x < 1.0 && inside.y > 0.0 && inside.y < 1.0) share = texture(fine, inside).r;
    }
    vec4 over = texture(palette, vec2(share * 0.996 + 0.002, 0.5));
    ground = mix(ground, over.rgb, over.a * heat);
  }
  colour = vec4(ground, 1.0);
}`;

/** How a pixel becomes a ray: half extents of the image plane, or null for a flat panorama. */
export interface Camera {
  plane: readonly [number, number] | null;
  panorama_R_view: Matrix;
  belief_R_view: Matrix;
  lens: readonly [number, number] | null; // of an ordinary picture
  heat: number; // strength, 0 draws none
}

export class Sphere {
  private readonly gl: WebGL2RenderingContext;
  private places = new Map<string, WebGLUniformLocation | null>();
  private textures: WebGLTexture[] = [];
  private hasPanorama = false;
  private window: Window | null = null;
  private fence: WebGLSync | null = null;

  /** Throws without WebGL 2. */
  constructor(readonly canvas: HTMLCanvasElement) {
    const gl = canvas.getContext("webgl2", { antialias: false, alpha: false, depth: false, powerPreference: "low-power" });
    if (!gl) throw new Error("no WebGL 2");
    this.gl = gl;
    this.build();
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => this.build());
  }

  /** Makes program and textures: at the start, and after a graphics driver was started anew and all of them are gone. */
  private build(): void {
    const gl = this.gl;
    [this.places, this.textures, this.fence] = [new Map(), [], null];
    const program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]] as const) {
      const shader = gl.createShader(kind)!;
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost())
      throw new Error(gl.getProgramInfoLog(program) ?? "no shader");
    gl.useProgram(program);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, Float32Array.of(-1, -1, 3, -1, -1, 3), gl.STATIC_DRAW);
    const corner = gl.getAttribLocation(program, "corner");
    gl.enableVertexAttribArray(corner);
    gl.vertexAttribPointer(corner, 2, gl.FLOAT, false, 0, 0);
    ["panorama", "coarse", "fine", "palette"].forEach((name, unit) => {
      this.textures.push(gl.createTexture());
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, this.textures[unit]);
      for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, side, gl.LINEAR);
      const around = name === "panorama" || name === "coarse";
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, around ? gl.REPEAT : gl.CLAMP_TO_EDGE);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.R8, 1, 1, 0, gl.RED, gl.UNSIGNED_BYTE, Uint8Array.of(0));
      gl.uniform1i(gl.getUniformLocation(program, name), unit);
    });
    for (const name of ["isFlat", "hasPanorama", "hasFine", "plane", "lens", "panorama_R_view", "belief_R_view", "heat", "muted", "window"])
      this.places.set(name, gl.getUniformLocation(program, name));
    this.colours("heat");
  }

  colours(which: "heat" | "look"): void {
    const colours = which === "heat" ? heatColours() : lookColours();
    this.upload(3, (gl) => gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 256, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, colours));
  }

  panorama(image: TexImageSource | null): void {
    this.hasPanorama = image !== null;
    if (image) this.upload(0, (gl) => gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, gl.RGB, gl.UNSIGNED_BYTE, image));
  }

  /** Shares of the highest value as bytes, on the whole sphere and in a finer window. */
  heat(shares: HeatTexture | null): void {
    this.window = shares?.fine?.window ?? null;
    const set = (unit: number, { bytes, columns, rows }: Raster) =>
      this.upload(unit, (gl) => {
        gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
        gl.texImage2D(gl.TEXTURE_2D, 0, gl.R8, columns, rows, 0, gl.RED, gl.UNSIGNED_BYTE, bytes);
        gl.pixelStorei(gl.UNPACK_ALIGNMENT, 4);
      });
    set(1, shares?.coarse ?? { bytes: Uint8Array.of(0), columns: 1, rows: 1 });
    if (shares?.fine) set(2, shares.fine);
  }

  private upload(unit: number, set: (gl: WebGL2RenderingContext) => void): void {
    this.gl.activeTexture(this.gl.TEXTURE0 + unit);
    this.gl.bindTexture(this.gl.TEXTURE_2D, this.textures[unit]);
    set(this.gl);
  }

  draw(camera: Camera): void {
    const gl = this.gl;
    const place = (name: string) => this.places.get(name) ?? null;
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.uniform1i(place("isFlat"), camera.plane ? 0 : 1);
    gl.uniform2f(place("plane"), ...(camera.plane ?? [1, 1]));
    gl.uniform2f(place("lens"), ...(camera.lens ?? [0, 0]));
    gl.uniform1i(place("hasPanorama"), this.hasPanorama ? 1 : 0);
    gl.uniformMatrix3fv(place("panorama_R_view"), true, new Float32Array(camera.panorama_R_view ?? IDENTITY));
    gl.uniformMatrix3fv(place("belief_R_view"), true, new Float32Array(camera.belief_R_view));
    gl.uniform1f(place("heat"), camera.heat);
    gl.uniform1f(place("muted"), camera.heat > 0 ? 1 : 0);
    gl.uniform1i(place("hasFine"), this.window ? 1 : 0);
    if (this.window) {
      const { left, right, top, bottom } = this.window;
      gl.uniform4f(place("window"), left, right, top, bottom);
    }
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    if (this.fence) gl.deleteSync(this.fence);
    this.fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
  }

  /** Whether the last drawing is on the canvas; null while it is under way. */
  finished(): true | null {
    if (!this.fence) return true;
    // A lost context, or a fence of one that is gone, tells neither.
    if (this.gl.getSyncParameter(this.fence, this.gl.SYNC_STATUS) === this.gl.UNSIGNALED && !this.gl.isContextLost()) return null;
    this.gl.deleteSync(this.fence);
    this.fence = null;
    return true;
  }
}

interface Raster {
  bytes: Uint8Array;
  columns: number;
  rows: number;
}

export interface HeatTexture {
  coarse: Raster;
  fine: (Raster & { window: Window }) | null;
}

/** Heat as bytes: the root of the share of the highest density above the uniform one, as in the library's pictures. */
export function heatTexture(heat: Heat): HeatTexture {
  const most = Math.max(4 * Math.PI * heat.highest, 1 + 1e-9);
  const contrast = (1 - 1 / most) ** 2; // a belief that is nearly uniform hardly glows
  const bytes = (values: Float32Array) =>
    Uint8Array.from(values, (value) => {
      const share = (4 * Math.PI * value - 1) / (most - 1);
      return share > 0 ? Math.min(255, Math.round(255 * contrast * Math.sqrt(share))) : 0;
    });
  const raster = (layer: { lattice: { elevations: Float64Array; azimuths: Float64Array }; values: Float32Array }) => ({
    bytes: bytes(layer.values),
    columns: layer.lattice.azimuths.length,
    rows: layer.lattice.elevations.length,
  });
  return { coarse: raster(heat.coarse), fine: heat.fine && { ...raster(heat.fine), window: heat.fine.window } };
}

/** Evidence as bytes: 128 where nothing is said, more where the target is more likely. */
export function lookTexture(values: Float32Array, columns: number, rows: number): HeatTexture {
  let most = 1e-3;
  for (const value of values) most = Math.max(most, Math.abs(value));
  const bytes = Uint8Array.from(values, (value) => Math.round(127.5 + 127.5 * Math.sign(value) * Math.sqrt(Math.abs(value) / most)));
  return { coarse: { bytes, columns, rows }, fine: null };
}

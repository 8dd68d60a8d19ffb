/** Panorama and heat on a canvas with WebGL 2, from inside the sphere or flat. Marks are drawn over it elsewhere. */

import type { Matrix } from "../math/rotation";
import { colours } from "./palette";

const VERTEX = `#version 300 es
in vec2 corner;
out vec2 at;
void main() { at = corner; gl_Position = vec4(corner, 0.0, 1.0); }`;

// `flat` pixels are azimuth and elevation, the others rays through the image plane x = 1.
const FRAGMENT = `#version 300 es
precision highp float;
in vec2 at;
out vec4 colour;
uniform bool isFlat, hasPanorama;
uniform vec2 plane, lens; // lens: half extents of an ordinary picture, 0 for a panorama
uniform mat3 panorama_R_view, world_R_view;
uniform float heat; // 1: it glows, and the panorama is muted
uniform sampler2D panorama, belief, palette;
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
    ground = mix(ground, mix(vec3(grey), ground, 0.75) * 0.82, heat);
  } else ground = mix(vec3(0.12, 0.135, 0.165), vec3(0.165, 0.18, 0.215), smoothstep(-0.6, 0.9, ray.z));
  if (heat > 0.0) {
    float share = texture(belief, place(world_R_view * ray)).r;
    vec4 over = texture(palette, vec2(share * 0.996 + 0.002, 0.5));
    ground = mix(ground, over.rgb, over.a * heat);
  }
  colour = vec4(ground, 1.0);
}`;

/** How a pixel becomes a ray: half extents of the image plane, or null for a flat panorama. */
export interface Camera {
  plane: readonly [number, number] | null;
  panorama_R_view: Matrix;
  world_R_view: Matrix;
  lens: readonly [number, number] | null; // of an ordinary picture
  glows: boolean;
}

export class Sphere {
  private readonly gl: WebGL2RenderingContext;
  private places = new Map<string, WebGLUniformLocation | null>();
  private textures: WebGLTexture[] = [];
  private hasPanorama = false;
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
    gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
    ["panorama", "belief", "palette"].forEach((name, unit) => {
      this.textures.push(gl.createTexture());
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, this.textures[unit]);
      for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, side, gl.LINEAR);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, name === "palette" ? gl.CLAMP_TO_EDGE : gl.REPEAT);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.R8, 1, 1, 0, gl.RED, gl.UNSIGNED_BYTE, Uint8Array.of(0));
      gl.uniform1i(gl.getUniformLocation(program, name), unit);
    });
    for (const name of ["isFlat", "hasPanorama", "plane", "lens", "panorama_R_view", "world_R_view", "heat"])
      this.places.set(name, gl.getUniformLocation(program, name));
  }

  panorama(image: TexImageSource | null): void {
    this.hasPanorama = image !== null;
    if (image) this.upload(0, (gl) => gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, gl.RGB, gl.UNSIGNED_BYTE, image));
  }

  /** What glows: a grey panorama in the axes of the world, and which colours its greys have. */
  heat(image: TexImageSource | null, which: "heat" | "look"): void {
    if (!image) return;
    this.upload(1, (gl) => gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, gl.RGB, gl.UNSIGNED_BYTE, image));
    this.upload(2, (gl) => gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 256, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, colours(which)));
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
    gl.uniformMatrix3fv(place("panorama_R_view"), true, new Float32Array(camera.panorama_R_view));
    gl.uniformMatrix3fv(place("world_R_view"), true, new Float32Array(camera.world_R_view));
    gl.uniform1f(place("heat"), camera.glows ? 1 : 0);
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

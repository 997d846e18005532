// Draws Gaussians with WebGL2: sorted back to front, blended into a picture of half floats, and only then coloured.
// So a temperature is blended as a number, and what stands under the pointer can be read.
"use strict";

const VERTEX = `#version 300 es
precision highp float;
precision highp sampler2D;
uniform sampler2D gaussians;
uniform mat4 view;
uniform vec2 focal, size;
in vec2 corner;
in uint index;
out vec2 at;
out vec4 shown;
void main() {
  ivec2 base = ivec2(int(index & 511u) * 4, int(index >> 9u));
  vec4 a = texelFetch(gaussians, base, 0), b = texelFetch(gaussians, base + ivec2(1, 0), 0);
  vec4 c = texelFetch(gaussians, base + ivec2(2, 0), 0), d = texelFetch(gaussians, base + ivec2(3, 0), 0);
  vec3 p = (view * vec4(a.xyz, 1.0)).xyz;
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  if (p.z < 0.02) return;
  vec2 limit = 0.65 * size / focal;
  vec2 t = clamp(p.xy / p.z, -limit, limit) * p.z;
  mat3 world = mat3(b.x, b.y, b.z, b.y, b.w, c.x, b.z, c.x, c.y);
  mat3 turn = mat3(view);
  mat3 seen = turn * world * transpose(turn);
  vec3 jx = vec3(focal.x / p.z, 0.0, -focal.x * t.x / (p.z * p.z));
  vec3 jy = vec3(0.0, focal.y / p.z, -focal.y * t.y / (p.z * p.z));
  vec3 sx = seen * jx, sy = seen * jy;
  float xx = dot(jx, sx) + 0.3, xy = dot(jx, sy), yy = dot(jy, sy) + 0.3;
  float middle = 0.5 * (xx + yy), apart = sqrt(max(0.25 * (xx - yy) * (xx - yy) + xy * xy, 1e-12));
  float large = middle + apart, small = max(middle - apart, 0.05);
  vec2 axis = abs(xy) > 1e-9 ? normalize(vec2(xy, large - xx)) : (xx >= yy ? vec2(1.0, 0.0) : vec2(0.0, 1.0));
  float reach = sqrt(2.0 * log(max(c.z * 255.0, 1.0001)));
  vec2 pixels = reach * (corner.x * sqrt(large) * axis + corner.y * sqrt(small) * vec2(-axis.y, axis.x));
  vec2 centre = focal * p.xy / p.z;
  if (any(greaterThan(abs(centre), 0.5 * size + reach * sqrt(large)))) return;
  gl_Position = vec4((centre + pixels) * 2.0 / size * vec2(1.0, -1.0), 0.0, 1.0);
  at = reach * corner;
  shown = vec4(d.rgb, c.z);
}`;
const FRAGMENT = `#version 300 es
precision highp float;
in vec2 at;
in vec4 shown;
out vec4 colour;
void main() {
  float alpha = min(0.999, shown.a * exp(-0.5 * dot(at, at)));
  if (alpha < 1.0 / 255.0) discard;
  colour = vec4(shown.rgb * alpha, alpha);
}`;
const SCREEN_VERTEX = `#version 300 es
out vec2 uv;
void main() { vec2 p = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0; uv = p; gl_Position = vec4(p * 2.0 - 1.0, 0.0, 1.0); }`;
const SCREEN_FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D picture, palette;
uniform vec3 background;
uniform vec2 span;
uniform bool thermal;
in vec2 uv;
out vec4 colour;
void main() {
  vec4 p = texture(picture, uv);
  if (!thermal) { colour = vec4(p.rgb + (1.0 - p.a) * background, 1.0); return; }
  float level = clamp((p.r / max(p.a, 1e-4) - span.x) / (span.y - span.x), 0.0, 1.0);
  vec3 found = texture(palette, vec2((level * 255.0 + 0.5) / 256.0, 0.5)).rgb;
  colour = vec4(mix(vec3(0.086, 0.086, 0.102), found, smoothstep(0.02, 0.4, p.a)), 1.0);
}`;

function bytesOf(text) {
  const raw = atob(text), out = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) out[i] = raw.charCodeAt(i);
  return out.buffer;
}

class Splats {
  constructor(canvas, data) {
    const gl = canvas.getContext("webgl2", { antialias: false, alpha: false, powerPreference: "high-performance" });
    if (!gl) throw new Error("This browser has no WebGL 2, so the model cannot be drawn.");
    this.gl = gl;
    this.canvas = canvas;
    this.floats = gl.getExtension("EXT_color_buffer_float") !== null || gl.getExtension("EXT_color_buffer_half_float") !== null;
    this.splat = this._program(VERTEX, FRAGMENT, ["corner", "index"]);
    this.screen = this._program(SCREEN_VERTEX, SCREEN_FRAGMENT, []);
    this.models = { rgb: this._model(data.rgb), thermal: this._model(data.thermal) };
    this.palettes = {};
    for (const [name, text] of Object.entries(data.palettes)) this.palettes[name] = this._palette(new Uint8Array(bytesOf(text)));
    this.background = data.background;
    this.corners = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, this.corners);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]), gl.STATIC_DRAW);
    this.target = { width: 0, height: 0, frame: gl.createFramebuffer(), picture: gl.createTexture() };
    const info = gl.getExtension("WEBGL_debug_renderer_info");
    const renderer = info ? String(gl.getParameter(info.UNMASKED_RENDERER_WEBGL)) : "";
    this.software = /swiftshader|llvmpipe|software|basic render/i.test(renderer);
  }

  _program(vertex, fragment, attributes) {
    const gl = this.gl, program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(program, shader);
    }
    attributes.forEach((name, i) => gl.bindAttribLocation(program, i, name));
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    return { program, at: (name) => gl.getUniformLocation(program, name) };
  }

  // Four texels a Gaussian: position; covariance xx xy xz yy; covariance yz zz and opacity; colour or level.
  _model(data) {
    const gl = this.gl, n = data.count, means = new Float32Array(bytesOf(data.means));
    const sizes = new Uint16Array(bytesOf(data.sizes)), quats = new Int16Array(bytesOf(data.quats));
    const alphas = new Uint8Array(bytesOf(data.alphas));
    const colours = data.colours ? new Uint8Array(bytesOf(data.colours)) : null;
    const levels = data.levels ? new Uint16Array(bytesOf(data.levels)) : null;
    const rows = Math.max(1, Math.ceil(n / 512)), texels = new Float32Array(rows * 512 * 16);
    for (let i = 0; i < n; i++) {
      const o = 16 * i, s = [0, 1, 2].map((k) => Math.exp(data.smallest + (data.largest - data.smallest) * sizes[3 * i + k] / 65535));
      let [w, x, y, z] = [quats[4 * i], quats[4 * i + 1], quats[4 * i + 2], quats[4 * i + 3]];
      const l = Math.hypot(w, x, y, z) || 1;
      w /= l; x /= l; y /= l; z /= l;
      const r = [
        (1 - 2 * (y * y + z * z)) * s[0], 2 * (x * y - w * z) * s[1], 2 * (x * z + w * y) * s[2],
        2 * (x * y + w * z) * s[0], (1 - 2 * (x * x + z * z)) * s[1], 2 * (y * z - w * x) * s[2],
        2 * (x * z - w * y) * s[0], 2 * (y * z + w * x) * s[1], (1 - 2 * (x * x + y * y)) * s[2],
      ];
      const dot = (a, b) => r[3 * a] * r[3 * b] + r[3 * a + 1] * r[3 * b + 1] + r[3 * a + 2] * r[3 * b + 2];
      texels.set([means[3 * i], means[3 * i + 1], means[3 * i + 2], 0, dot(0, 0), dot(0, 1), dot(0, 2), dot(1, 1)], o);
      texels.set([dot(1, 2), dot(2, 2), alphas[i] / 255, 0], o + 8);
      if (colours) texels.set([colours[3 * i] / 255, colours[3 * i + 1] / 255, colours[3 * i + 2] / 255], o + 12);
      else texels[o + 12] = levels[i] / 65535;
    }
    const texture = this._texture(gl.NEAREST);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, 2048, rows, 0, gl.RGBA, gl.FLOAT, texels);
    return { n, means, texture, order: new Uint32Array(n), keys: new Uint16Array(n), buffer: gl.createBuffer(), sortedFor: null };
  }

  _texture(filter) {
    const gl = this.gl, texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    for (const [name, value] of [["MIN_FILTER", filter], ["MAG_FILTER", filter], ["WRAP_S", gl.CLAMP_TO_EDGE], ["WRAP_T", gl.CLAMP_TO_EDGE]])
      gl.texParameteri(gl.TEXTURE_2D, gl["TEXTURE_" + name], value);
    return texture;
  }

  _palette(rgb) {
    const gl = this.gl, texture = this._texture(gl.NEAREST);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, 256, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, rgb);
    return texture;
  }

  // Farthest first, by a counting sort on 16 bits of depth.
  _sort(model, view) {
    const key = [view[2], view[6], view[10], view[14]];
    if (model.sortedFor && model.sortedFor.every((v, i) => Math.abs(v - key[i]) < 1e-6)) return;
    model.sortedFor = key;
    const { n, means, keys, order } = model, counts = new Uint32Array(65537);
    let lo = Infinity, hi = -Infinity;
    const depth = new Float32Array(n);
    for (let i = 0; i < n; i++) {
      const d = key[0] * means[3 * i] + key[1] * means[3 * i + 1] + key[2] * means[3 * i + 2] + key[3];
      depth[i] = d;
      if (d < lo) lo = d;
      if (d > hi) hi = d;
    }
    lo = Math.max(lo, 0);
    const step = 65535 / Math.max(hi - lo, 1e-9);
    for (let i = 0; i < n; i++) {
      keys[i] = 65535 - Math.max(0, Math.min(65535, (depth[i] - lo) * step));
      counts[1 + keys[i]]++;
    }
    for (let k = 0; k < 65536; k++) counts[k + 1] += counts[k];
    for (let i = 0; i < n; i++) order[counts[keys[i]]++] = i;
    const gl = this.gl;
    gl.bindBuffer(gl.ARRAY_BUFFER, model.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, order, gl.DYNAMIC_DRAW);
  }

  _resize(width, height) {
    const gl = this.gl, t = this.target;
    if (t.width === width && t.height === height) return;
    [t.width, t.height] = [width, height];
    gl.deleteTexture(t.picture);
    t.picture = this._texture(gl.LINEAR);
    if (this.floats) gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA16F, width, height, 0, gl.RGBA, gl.HALF_FLOAT, null);
    else gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, width, height, 0, gl.RGBA, gl.UNSIGNED_BYTE, null);
    gl.bindFramebuffer(gl.FRAMEBUFFER, t.frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, t.picture, 0);
  }

  // view: 16 numbers, column by column, OpenCV axes. focal: pixels of the canvas. reduction: draw in pixels so much larger.
  draw({ kind, view, focal, palette, span, reduction }) {
    const gl = this.gl, model = this.models[kind], thermal = kind === "thermal";
    const width = Math.max(1, Math.round(this.canvas.width / reduction)), height = Math.max(1, Math.round(this.canvas.height / reduction));
    this._resize(width, height);
    this._sort(model, view);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target.frame);
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.useProgram(this.splat.program);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, model.texture);
    gl.uniform1i(this.splat.at("gaussians"), 0);
    gl.uniformMatrix4fv(this.splat.at("view"), false, view);
    gl.uniform2f(this.splat.at("focal"), focal * width / this.canvas.width, focal * height / this.canvas.height);
    gl.uniform2f(this.splat.at("size"), width, height);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.corners);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 2, gl.FLOAT, false, 0, 0);
    gl.vertexAttribDivisor(0, 0);
    gl.bindBuffer(gl.ARRAY_BUFFER, model.buffer);
    gl.enableVertexAttribArray(1);
    gl.vertexAttribIPointer(1, 1, gl.UNSIGNED_INT, 0, 0);
    gl.vertexAttribDivisor(1, 1);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, model.n);
    gl.disableVertexAttribArray(1);
    gl.disableVertexAttribArray(0);
    gl.disable(gl.BLEND);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.useProgram(this.screen.program);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.target.picture);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, this.palettes[palette]);
    gl.uniform1i(this.screen.at("picture"), 0);
    gl.uniform1i(this.screen.at("palette"), 1);
    gl.uniform1i(this.screen.at("thermal"), thermal ? 1 : 0);
    gl.uniform3fv(this.screen.at("background"), this.background);
    gl.uniform2fv(this.screen.at("span"), span);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  // What was blended at a place of the canvas, in [0, 1]: level and cover of the picture that was drawn last.
  read(x, y) {
    const gl = this.gl, t = this.target, found = this.floats ? new Float32Array(4) : new Uint8Array(4);
    gl.bindFramebuffer(gl.FRAMEBUFFER, t.frame);
    gl.readPixels(Math.floor(x * t.width), Math.floor((1 - y) * t.height), 1, 1, gl.RGBA, this.floats ? gl.FLOAT : gl.UNSIGNED_BYTE, found);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    const [level, cover] = this.floats ? [found[0], found[3]] : [found[0] / 255, found[3] / 255];
    return { level: level / Math.max(cover, 1e-4), cover };
  }
}

/**
 * The surface as the graphics card draws it: a small patch of cells, once for each tile of the grid, lifted by a texture
 * of heights. Light and gaps come from textures at full resolution, whatever the number of triangles.
 */

export const SURFACE_VERTEX = `
precision highp float;
precision highp int;
in vec2 position;
in vec2 tile;
uniform highp sampler2D heights;
uniform highp sampler2D known;
uniform ivec2 size;
uniform int stride;
uniform vec2 spacing;
uniform float middle;
uniform float lift;
uniform float pointSize;
uniform mat4 modelViewMatrix;
uniform mat4 projectionMatrix;
// "centroid": where a triangle covers a part of a pixel, the middle of the pixel may lie far outside a thin one.
centroid out vec2 place;
flat out vec2 corner;
centroid out float value;
void main() {
  ivec2 at = min(ivec2(tile) + ivec2(position) * stride, size - 1);
  value = texelFetch(heights, at, 0).r;
  place = corner = vec2(at);
  vec2 centred = (vec2(at) - 0.5 * vec2(size - 1)) * spacing;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(centred, (value - middle) * lift, 1.0);
  gl_PointSize = pointSize;
  if (pointSize > 0.0 && texelFetch(known, at, 0).r == 0.0) gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
}`;

export const SURFACE_FRAGMENT = `
precision highp float;
precision highp int;
precision highp sampler2D;
centroid in vec2 place;
flat in vec2 corner;
centroid in float value;
uniform ivec2 size;
uniform int stride;
uniform sampler2D triangles;
uniform sampler2D slopes;
uniform sampler2D micrograph;
uniform sampler2D planes;
uniform sampler2D table;
uniform int colourBy;
uniform vec2 range;
uniform vec3 light;
uniform float shading;
uniform float exaggeration;
uniform vec3 toEye;
uniform float wire;
uniform float pointSize;
out vec4 colour;

void main() {
  if (pointSize > 0.0) {
    vec2 disc = gl_PointCoord - 0.5;
    if (dot(disc, disc) > 0.25) discard;
  } else {
    ivec2 cell = clamp(ivec2(place), ivec2(0), size - 2);
    vec2 within = place - vec2(cell);
    int part = within.x + within.y < 1.0 ? 1 : 2;
    if (stride == 1) {
      // Exact at the edges of a gap, where the interpolated place may lie in the cell beside.
      vec2 off = place - corner;
      part = off.x + off.y >= 0.0 ? 1 : 2;
      cell = ivec2(corner) - (part - 1);
    }
    if ((int(texelFetch(triangles, cell, 0).r * 255.0 + 0.5) & part) == 0) discard;
  }
  vec2 uv = (place + 0.5) / vec2(size);
  vec3 base;
  if (colourBy == 0) base = vec3(pow(texture(micrograph, uv).r, 0.72));
  else {
    float shown = value;
    if (colourBy == 2) shown = texelFetch(planes, ivec2(place + 0.5), 0).r * 255.0;
    if (colourBy == 3) shown = texelFetch(planes, ivec2(place + 0.5), 0).g * 255.0;
    float t = clamp((shown - range.x) / (range.y - range.x), 0.0, 1.0);
    base = texture(table, vec2((t * 255.0 + 0.5) / 256.0, 0.5)).rgb;
  }
  vec3 normal = normalize(vec3(-texture(slopes, uv).rg * exaggeration, 1.0));
  float under = dot(normal, toEye) < -0.25 && !gl_FrontFacing ? 1.0 : 0.0;
  float direct = max(dot(normal, light), 0.0);
  float sky = 0.5 + 0.5 * normal.z;
  vec3 halfway = normalize(light + toEye);
  float gloss = pow(max(dot(normal, halfway), 0.0), 42.0) * 0.16;
  float lit = 0.30 + 0.17 * sky + 0.74 * direct;
  base = base * mix(1.0, lit, shading) + gloss * shading;
  base *= 1.0 - 0.55 * under;
  if (wire > 0.0) {
    vec2 lines = abs(fract(place / wire - 0.5) - 0.5) * wire / max(fwidth(place), vec2(1e-6));
    float line = 1.0 - clamp(min(lines.x, lines.y) - 0.15, 0.0, 1.0);
    float dark = dot(base, vec3(0.3, 0.6, 0.1));
    base = mix(base * 0.92, dark > 0.42 ? vec3(0.06, 0.08, 0.11) : vec3(0.94, 0.96, 1.0), line * 0.62);
  }
  colour = vec4(base, 1.0);
}`;

export const SCREEN_VERTEX = `
precision highp float;
in vec3 position;
out vec2 uv;
void main() {
  uv = 0.5 * position.xy + 0.5;
  gl_Position = vec4(position.xy, 0.0, 1.0);
}`;

/** One picture as it is, or two as red-cyan for glasses (the matrices of Dubois, doi:10.1109/ICASSP.2001.941256). */
export const SCREEN_FRAGMENT = `
precision highp float;
in vec2 uv;
uniform sampler2D left;
uniform sampler2D right;
uniform float anaglyph;
out vec4 colour;
void main() {
  vec4 one = texture(left, uv);
  if (anaglyph == 0.0) { colour = one; return; }
  vec4 two = texture(right, uv);
  // In grey, or a colour that one eye does not see would flicker.
  one.rgb = vec3(dot(one.rgb, vec3(0.3, 0.59, 0.11)));
  two.rgb = vec3(dot(two.rgb, vec3(0.3, 0.59, 0.11)));
  vec3 mixed = mat3(0.456, -0.0400822, -0.0152161, 0.500484, -0.0378246, -0.0205971, 0.176381, -0.0157589, -0.00546856) * one.rgb
    + mat3(-0.0434706, 0.378476, -0.0721527, -0.0879388, 0.73364, -0.112961, -0.00155529, -0.0184503, 1.2264) * two.rgb;
  colour = vec4(clamp(mixed, 0.0, 1.0), max(one.a, two.a));
}`;

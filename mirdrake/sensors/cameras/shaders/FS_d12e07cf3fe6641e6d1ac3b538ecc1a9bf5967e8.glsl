// Smooths edges in place of VTK's FXAA filter, which it is named after (SHA-1 of that shader's text).
// A pixel is mixed with the neighbour across the stronger edge, the more, the less it is like its four neighbours.
// Green stands for brightness.
#version 150
in vec2 texCoord;
out vec4 fragOutput0;
uniform sampler2D Input;
uniform vec2 InvTexSize;
void main()
{
  ivec2 at = ivec2(texCoord / InvTexSize);
  ivec2 low = max(at - 1, ivec2(0)), high = min(at + 1, textureSize(Input, 0) - 1);
  vec4 here = texelFetch(Input, at, 0);
  vec3 above = texelFetch(Input, ivec2(at.x, high.y), 0).rgb;
  vec3 below = texelFetch(Input, ivec2(at.x, low.y), 0).rgb;
  vec3 right = texelFetch(Input, ivec2(high.x, at.y), 0).rgb;
  vec3 left = texelFetch(Input, ivec2(low.x, at.y), 0).rgb;
  vec4 apart = vec4(above.g, below.g, right.g, left.g) - here.g;
  float brightest = max(max(apart.x, apart.y), max(apart.z, max(apart.w, 0.0)));
  float contrast = brightest - min(min(apart.x, apart.y), min(apart.z, min(apart.w, 0.0)));
  float blend = 0.75 * min(abs(dot(apart, vec4(0.25))) / max(contrast, 1e-4), 1.0);
  blend = contrast < max(0.0625, 0.125 * (here.g + brightest)) ? 0.0 : blend;
  vec4 size = abs(apart);
  bool horizontal = abs(apart.x + apart.y) >= abs(apart.z + apart.w);
  vec3 across = horizontal ? (size.x >= size.y ? above : below) : (size.z >= size.w ? right : left);
  fragOutput0 = vec4(mix(here.rgb, across, blend), here.a);
}

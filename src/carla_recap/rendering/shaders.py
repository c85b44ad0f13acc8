"""The shaders of the renderer, in GLSL, and the uniform blocks that they read.

Positions are relative to the camera, in m, along the axes of the world (right-handed). Light is computed for each vertex:
pixels then cost little, and surfaces are flat or finely divided. Fog is computed for each pixel, since the ground is not.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.rendering.camera import ImageKind
from carla_recap.scene.materials import MATERIALS, Material, Tag

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

VERTEX: Final = np.dtype([("position", "3f4"), ("normal", "3f4"), ("material", "u4")])
"""A vertex of the ground."""
MODEL_VERTEX: Final = np.dtype([*((name, VERTEX[name]) for name in VERTEX.names or ()), ("color", "3f4"), ("pivot", "3f4")])
"""A vertex of a model; its colour is from 0 to 1; `pivot` is x and y of the steering axis, and 1 if it is steered."""
INSTANCE: Final = np.dtype(
    [
        ("location", "3f4"),
        ("rotation", "9f4"),
        ("extents", "4f4"),  # half the sizes, and the angle of the front wheels
        ("paint", "4f4"),  # red, green, blue from 0 to 1, and the opacity
        ("marks", "4u4"),  # the lamps as two halves, the id, the tag
    ]
)
"""An instance; its rotation is a matrix, column by column."""
PREVIOUS: Final = np.dtype([("previous_location", "3f4"), ("previous_rotation", "9f4")])
"""Where an instance was in the previous image, relative to the previous camera."""
MATERIAL_COUNT: Final = 80
LEAST_SUN: Final = 0.35
"""The height of the sun, as a sine, below which shadows get no longer."""

_FRAME: Final = """
layout(std140) uniform Frame {
    mat4 clip;            // from positions relative to the camera to clip coordinates
    mat4 previous_clip;   // the same of the previous image
    vec4 origin;          // the origin of the ground, relative to the camera
    vec4 previous_origin;
    vec4 forward;         // the axes of the camera; right and up have the length of half the image at distance 1
    vec4 right;
    vec4 up;
    vec4 size;            // width and height of the image in pixels, the focal length in pixels
    vec4 sun;             // the direction to the sun
    vec4 sunlight;        // linear colours; sunlight.w: the brightness of the sun's disc
    vec4 skylight;        // light from above; w: wetness
    vec4 groundlight;     // light from below
    vec4 zenith;          // sRGB colours of the sky; w: cloudiness
    vec4 haze;            // the sky at the horizon, and the fog
    vec4 cloud_color;
    vec4 fog;             // density per m, distance at which it begins
    vec4 world;           // the location of the camera, modulo the size of the grain
};
"""
FRAME: Final = np.dtype(
    [(name, "(4,4)f4" if kind == "mat4" else "4f4") for kind, name in re.findall(r"^    (\w+) (\w+);", _FRAME, re.MULTILINE)]
)
"""The uniform block of an image, in std140; matrices column by column."""

_VERTEX: Final = """
vec3 linear(vec3 color) { return color * color * (color * 0.3 + 0.7); }
vec3 encoded(vec3 light) {
    light = light * (1.0 + light * 0.12) / (1.0 + light * 0.42);   // bright surfaces keep their colours
    return pow(light, vec3(1.0 / 2.2));
}
layout(std140) uniform Materials {
    vec4 finish[80];      // colour, gloss
    vec4 glow[80];        // the colour of the lit lamp; w: depth layer
    vec4 kind[80];        // tag or -1; whether it is paint; the width of a marking; the strength of the grain
};
in vec3 position;
in vec3 normal;
in uint material;
#ifdef INSTANCED
in vec3 color;
in vec3 pivot;
in vec3 location;
in mat3 rotation;
in vec4 extents;
in vec4 paint;
in uvec4 marks;
#ifdef FLOW
in vec3 previous_location;
in mat3 previous_rotation;
#endif
#endif
#ifdef RGB
out vec3 v_color;
#ifdef GRAIN
out vec3 v_grain;
#endif
#endif
#ifdef TRANSLUCENT
flat out float v_opacity;
#endif
#ifdef MARKS
flat out uvec3 v_marks;
#endif
#ifdef NORMALS
out vec3 v_normal;
#endif
#ifdef FLOW
out vec3 v_previous;
#endif

void main() {
    vec4 surface = kind[material];
#ifdef INSTANCED
    vec3 half_size = max(extents.xyz, vec3(1e-3));
    vec3 local = position * half_size;
    vec3 direction = normal / half_size;
    if (pivot.z > 0.5) {
        float s = sin(extents.w), c = cos(extents.w);
        mat2 turn = mat2(c, s, -s, c);
        vec2 axis = pivot.xy * half_size.xy;
        local.xy = turn * (local.xy - axis) + axis;
        direction.xy = turn * direction.xy;
    }
    vec3 here = rotation * local + location;
    vec3 n = normalize(rotation * direction);
#ifdef FLOW
    vec3 before = previous_rotation * local + previous_location;
#endif
#else
    vec3 here = position + origin.xyz;
    vec3 n = normal;
#ifdef FLOW
    vec3 before = position + previous_origin.xyz;
#endif
#endif
    gl_Position = clip * vec4(here, 1.0);
#ifdef INSTANCED
    gl_Position.z -= ACTOR_LAYER * gl_Position.w;
#else
    gl_Position.z -= glow[material].w * gl_Position.w;
#endif
#ifdef FLOW
    v_previous = (previous_clip * vec4(before, 1.0)).xyw;
#endif
#ifdef NORMALS
    v_normal = n;
#endif
#ifdef MARKS
#ifdef INSTANCED
    v_marks = uvec3(surface.x < 0.0 ? marks.w : uint(surface.x), marks.z & 255u, (marks.z >> 8) & 255u);
#else
    v_marks = uvec3(surface.x < 0.0 ? 0u : uint(surface.x), 0u, 0u);
#endif
#endif
#ifdef RGB
    float gloss = finish[material].a;
#ifdef INSTANCED
    vec3 base = surface.y > 0.5 ? paint.rgb : color;
#else
    vec3 base = finish[material].rgb;
#endif
#ifdef TRANSLUCENT
    v_opacity = paint.a;
#endif
    float distance = length(here);
    vec3 view = here / max(distance, 1e-3);
    if (surface.z > 0.0) base = mix(finish[ROAD].rgb, base, clamp(surface.z * size.z / distance, 0.45, 1.0));
    vec3 light = mix(groundlight.rgb, skylight.rgb, n.z * 0.5 + 0.5) + sunlight.rgb * max(dot(n, sun.xyz), 0.0);
    vec3 seen = linear(base) * light;
#ifndef INSTANCED
    gloss += skylight.w * 0.35 * max(n.z, 0.0);
    seen *= 1.0 - 0.35 * skylight.w;
#endif
    if (gloss > 0.0) {
        vec3 mirrored = reflect(view, n);
        float grazing = 1.0 - abs(dot(view, n));
        float share = gloss * (0.1 + 0.9 * grazing * grazing * grazing * grazing);
        vec3 sky = linear(mix(haze.rgb, zenith.rgb, sqrt(clamp(mirrored.z, 0.0, 1.0)))) * 1.1;
        vec3 ground = groundlight.rgb * 0.5;
        seen = mix(seen, mix(ground, sky, smoothstep(-0.1, 0.15, mirrored.z)), share);
        seen += sunlight.rgb * gloss * pow(max(dot(mirrored, sun.xyz), 0.0), 40.0);
    }
    v_color = encoded(seen);
#ifdef INSTANCED
    uint lamps = material < 32u ? marks.x : material < 64u ? marks.y : 0u;
    if (((lamps >> (material & 31u)) & 1u) == 1u) {
        v_color = glow[material].rgb;
#ifdef TRANSLUCENT
        v_opacity = 1.0;  // of an actor that can be seen through, lit lamps are still seen
#endif
    }
#endif
#ifdef GRAIN
    v_grain = vec3(here.xy + world.xy, surface.w * max(n.z, 0.0));
#endif
#endif
}
"""

_FRAGMENT: Final = """
vec3 encoded_depth(float depth) {
    float d = clamp(depth / 1000.0, 0.0, 1.0) * 16777215.0;
    return vec3(floor(d / 65536.0), mod(floor(d / 256.0), 256.0), mod(floor(d), 256.0)) / 255.0;
}
#ifdef RGB
in vec3 v_color;
#ifdef GRAIN
in vec3 v_grain;
uniform sampler2D noise;
#endif
#endif
#ifdef TRANSLUCENT
flat in float v_opacity;
#endif
#ifdef MARKS
flat in uvec3 v_marks;
#endif
#ifdef NORMALS
in vec3 v_normal;
#endif
#ifdef FLOW
in vec3 v_previous;
#endif

void main() {
    float depth = 1.0 / gl_FragCoord.w;
#ifdef RGB
    vec3 color = v_color;
#ifdef GRAIN
    if (v_grain.z > 0.0)
        color *= 1.0 + v_grain.z * ((texture(noise, v_grain.xy / 4.0).g - 0.5) * 1.3
            + (texture(noise, v_grain.xy / 64.0).r - 0.5) * 80.0 / (80.0 + depth));  // its repetition is not seen from above
#endif
    color = mix(haze.rgb, color, exp2(-fog.x * max(depth - fog.y, 0.0)));
#ifdef TRANSLUCENT
    o_rgb = vec4(color.bgr, v_opacity);
#else
    o_rgb = vec4(color.bgr, 1.0);
#endif
#endif
#ifdef SEMANTIC
    o_semantic = vec4(0.0, 0.0, float(v_marks.x) / 255.0, 1.0);
#endif
#ifdef INSTANCE
    o_instance = vec4(vec3(v_marks.zyx) / 255.0, 1.0);
#endif
#ifdef DEPTH
    o_depth = vec4(encoded_depth(depth), 1.0);
#endif
#ifdef NORMALS
    vec3 n = normalize(v_normal);
    o_normals = vec4(vec3(n.z, -n.y, n.x) * 0.5 + 0.5, 1.0);
#endif
#ifdef FLOW
    vec2 now = gl_FragCoord.xy / size.xy * 2.0 - 1.0;
    vec2 before = v_previous.xy / v_previous.z;
    o_flow = v_previous.z > 0.0 ? (now - before) * vec2(1.0, -1.0) : vec2(0.0);
#endif
}
"""

_SKY_VERTEX: Final = """
in vec2 corner;
out vec2 v_corner;
out vec3 v_ray;
void main() {
    v_corner = corner;
    v_ray = forward.xyz + corner.x * right.xyz - corner.y * up.xyz;
    gl_Position = vec4(corner, 1.0, 1.0);
}
"""

_SKY_FRAGMENT: Final = """
in vec2 v_corner;
in vec3 v_ray;
uniform sampler2D sky_map;

void main() {
#ifdef RGB
    vec2 place = vec2(v_ray.x + v_ray.y, v_ray.x - v_ray.y) / (abs(v_ray.x) + abs(v_ray.y) + max(v_ray.z, 0.0) + 1e-6);
    o_rgb = texture(sky_map, place * 0.5 + 0.5);
#endif
#ifdef SEMANTIC
    o_semantic = vec4(0.0, 0.0, SKY / 255.0, 1.0);
#endif
#ifdef INSTANCE
    o_instance = vec4(0.0, 0.0, SKY / 255.0, 1.0);
#endif
#ifdef DEPTH
    o_depth = vec4(1.0);
#endif
#ifdef NORMALS
    o_normals = vec4(0.5, 0.5, 0.5, 1.0);
#endif
#ifdef FLOW
    vec3 before = (previous_clip * vec4(v_ray, 0.0)).xyw;
    o_flow = before.z > 0.0 ? (v_corner - before.xy / before.z) * vec2(1.0, -1.0) : vec2(0.0);
#endif
}
"""

_CORNER_VERTEX: Final = """
in vec2 corner;
out vec2 v_corner;
void main() {
    v_corner = corner;
    gl_Position = vec4(corner, 0.0, 1.0);
}
"""

_SKY_MAP_FRAGMENT: Final = """
in vec2 v_corner;
uniform sampler2D clouds;

void main() {
    vec2 level = vec2(v_corner.x + v_corner.y, v_corner.x - v_corner.y) * 0.5;
    vec3 view = normalize(vec3(level, 1.0 - abs(level.x) - abs(level.y)));
    float height = max(view.z, 0.0);
    float low = 1.0 / (1.0 + height * 2.2);
    vec3 color = mix(zenith.rgb, haze.rgb, low * low * low);
    float toward = max(dot(view, sun.xyz), 0.0);
    if (view.z > 0.01 && zenith.w > 0.0) {
        vec2 at = view.xy / (view.z + 0.12);
        float density = texture(clouds, at * 0.05).r * 0.6 + texture(clouds, at * 0.17 + 0.3).r * 0.4;
        float cover = smoothstep(0.72 - 0.6 * zenith.w, 1.02 - 0.55 * zenith.w, density) * smoothstep(0.01, 0.2, view.z);
        color = mix(color, cloud_color.rgb, cover * (0.55 + 0.35 * zenith.w));
    }
    float toward8 = toward * toward;
    toward8 *= toward8;
    toward8 *= toward8;
    float toward32 = toward8 * toward8;
    toward32 *= toward32;
    float toward256 = toward32 * toward32;
    toward256 *= toward256;
    toward256 *= toward256;
    float disc = smoothstep(0.9997, 0.9999, toward) + 0.35 * toward256 + 0.12 * toward32;
    color += sunlight.w * disc * vec3(1.0, 0.95, 0.85);
    o_rgb = vec4(color.bgr, 1.0);
}
"""

_SHADOW_VERTEX: Final = """
in vec3 position;
in vec3 location;
in mat3 rotation;
in vec4 extents;
void main() {
    vec3 size = max(extents.xyz, vec3(1e-3));
    vec3 point = rotation * (position * size);
    vec3 up = rotation[2];
    float height = max(dot(up, point) + size.z, 0.0);
    vec3 direction = sun.xyz / max(dot(up, sun.xyz), LEAST_SUN);
    vec3 here = location + point - height * direction + 0.02 * up;
    gl_Position = clip * vec4(here, 1.0);
    gl_Position.z -= LAYER * gl_Position.w;
}
"""

_SHADOW_FRAGMENT: Final = """
void main() { o_rgb = vec4(1.0, 1.0, 1.0, sun.w); }
"""

_BLOB_VERTEX: Final = """
in vec2 corner;
in vec3 location;
in mat3 rotation;
in vec4 extents;
out vec2 v_place;
flat out vec2 v_size;
void main() {
    vec2 wide = extents.z < 0.15 ? vec2(0.0) : extents.xy + 0.35;  // what lies on the ground has no shadow around it
    v_size = extents.xy;
    v_place = corner * wide;
    vec3 here = location + rotation * vec3(v_place, 0.02 - extents.z);
    gl_Position = clip * vec4(here, 1.0);
    gl_Position.z -= LAYER * gl_Position.w;
}
"""

_BLOB_FRAGMENT: Final = """
in vec2 v_place;
flat in vec2 v_size;
void main() {
    vec2 outside = abs(v_place) - (v_size - 0.25);
    float edge = length(max(outside, vec2(0.0))) / 0.6;
    float shade = clamp(1.0 - edge, 0.0, 1.0);
    o_rgb = vec4(1.0, 1.0, 1.0, 1.0 - 0.5 * shade * shade);
}
"""

_COVER_FRAGMENT: Final = """
void main() { o_rgb = vec4(0.0, 0.0, 0.0, 1.0); }
"""

_HALO_VERTEX: Final = """
in vec2 corner;
in vec4 center;
in vec3 light;
out vec2 v_corner;
flat out vec3 v_light;
void main() {
    v_corner = corner;
    v_light = light * exp2(-0.5 * fog.x * length(center.xyz));
    vec3 here = center.xyz + center.w * (corner.x * normalize(right.xyz) + corner.y * normalize(up.xyz));
    gl_Position = clip * vec4(here, 1.0);
}
"""

_HALO_FRAGMENT: Final = """
in vec2 v_corner;
flat in vec3 v_light;
void main() {
    float fading = max(1.0 - length(v_corner), 0.0);
    o_rgb = vec4(v_light.bgr * fading * fading, 0.0);
}
"""

_REDUCE_FRAGMENT: Final = """
in vec2 v_corner;
uniform sampler2D image;
void main() {
    vec2 place = v_corner * 0.5 + 0.5;
    vec2 pixel = vec2(COLUMNS, ROWS) / vec2(textureSize(image, 0));
    vec3 sum = vec3(0.0);
    SUM
    o_rgb = vec4(sum / READS, 1.0);
}
"""

_LAYERS: Final = {
    Material.SHOULDER: 1,
    Material.PARKING: 1,
    Material.BIKE_LANE: 1,
    Material.MEDIAN: 1,
    Material.ROAD: 2,
    Material.JUNCTION: 3,
    Material.SIDEWALK: 2,
    Material.CROSSING: 5,
    Material.WHITE_LINE: 5,
    Material.YELLOW_LINE: 5,
    Material.STOP_LINE: 6,
}
_LAYER: Final = 2e-6  # of the depth of clip space
_SHADOW_LAYER: Final = 7 * _LAYER
_ACTOR_LAYER: Final = 8 * _LAYER  # else what lies on the ground is below a marking or the mark of a collision, seen from far
_WIDTHS: Final = {Material.WHITE_LINE: 0.15, Material.YELLOW_LINE: 0.15, Material.STOP_LINE: 0.5, Material.CROSSING: 0.5}
"""The widths of markings, in m; those that are less than a pixel wide are faint, and do not flicker."""
_GRAINS: Final = {
    Material.GRASS: 0.5,
    Material.GROUND: 0.35,
    Material.MEDIAN: 0.2,
    Material.SHOULDER: 0.25,
    Material.PARKING: 0.2,
    Material.BIKE_LANE: 0.15,
    Material.ROAD: 0.22,
    Material.JUNCTION: 0.22,
    Material.SIDEWALK: 0.12,
    Material.BRIDGE: 0.1,
}


def reducing(columns: int, rows: int) -> tuple[str, ...]:
    """Return the options of shaders that average rectangles of pixels of an RGB image; see `sources`."""
    places = [(x, y) for y in _offsets(rows) for x in _offsets(columns)]
    terms = " ".join(f"sum += texture(image, place + pixel * vec2({x}, {y})).rgb;" for x, y in places)
    return f"SUM {terms}", f"COLUMNS {columns}.0", f"ROWS {rows}.0", f"READS {len(places)}.0"


def _offsets(pixels: int) -> list[float]:
    """Return where to read an image to average a number of pixels, from their middle, as parts of them.

    A read between two pixels gives the mean of both.
    """
    reads = pixels // 2 if pixels % 2 == 0 else pixels
    return [(2 * read + 1) / (2 * reads) - 0.5 for read in range(reads)]


def material_block() -> NDArray[np.float32]:
    """Return the uniform block of the materials, (3, materials, 4)."""
    block = np.zeros((3, MATERIAL_COUNT, 4), np.float32)
    for material, finish in MATERIALS.items():
        block[0, material] = (*(np.array(finish.color) / 255), finish.gloss)
        block[1, material] = (*(np.array(finish.glow or finish.color) / 255), _LAYER * _LAYERS.get(material, 0))
        tag = -1 if finish.tag is None else finish.tag
        block[2, material] = (tag, material == Material.PAINT, _WIDTHS.get(material, 0), _GRAINS.get(material, 0))
    return block


def sources(name: str, kinds: Sequence[ImageKind], *options: str) -> tuple[str, str]:
    """Return the source texts of a vertex shader and its fragment shader.

    Args:
        name: "surface", "sky", "sky_map", "shadow", "blob", "cover", "halo" or "reduce".
        kinds: The kinds of images that it draws, in the order of the attachments.
        options: INSTANCED, GRAIN, TRANSLUCENT, or those of `reducing`.
    """
    vertex, fragment = {
        "surface": (_VERTEX, _FRAGMENT),
        "sky": (_SKY_VERTEX, _SKY_FRAGMENT),
        "sky_map": (_CORNER_VERTEX, _SKY_MAP_FRAGMENT),
        "shadow": (_SHADOW_VERTEX, _SHADOW_FRAGMENT),
        "blob": (_BLOB_VERTEX, _BLOB_FRAGMENT),
        "cover": (_CORNER_VERTEX, _COVER_FRAGMENT),
        "halo": (_HALO_VERTEX, _HALO_FRAGMENT),
        "reduce": (_CORNER_VERTEX, _REDUCE_FRAGMENT),
    }[name]
    defined = [kind.name for kind in kinds] + list(options)
    if ImageKind.SEMANTIC in kinds or ImageKind.INSTANCE in kinds:
        defined.append("MARKS")
    head = "#version 330\n" + "".join(f"#define {each}\n" for each in defined)
    numbers = {"SKY": f"{Tag.SKY:d}.0", "ROAD": Material.ROAD.value, "LEAST_SUN": LEAST_SUN}
    numbers |= {"LAYER": f"{_SHADOW_LAYER:.8f}", "ACTOR_LAYER": f"{_ACTOR_LAYER:.8f}"}
    head += "".join(f"#define {key} {value}\n" for key, value in numbers.items()) + _FRAME
    outputs = "".join(
        f"layout(location={index}) out {'vec2' if kind is ImageKind.FLOW else 'vec4'} o_{kind.name.lower()};\n"
        for index, kind in enumerate(kinds)
    )
    return head + vertex, head + outputs + fragment

// Questions about the channels of a state: which is under the pointer, how long, how winding.

/** Nearest point of all channels to a place, within a reach in m. */
export function nearest(state, x, y, reach) {
  let best = reach * reach, point = -1;
  const xy = state.xy;
  for (let i = 0; i < state.points; i++) {
    const dx = xy[2 * i] - x, dy = xy[2 * i + 1] - y, d = dx * dx + dy * dy;
    if (d < best) { best = d; point = i; }
  }
  if (point < 0) return null;
  return { point, channel: channelOf(state, point), away: Math.sqrt(best), x: xy[2 * point], y: xy[2 * point + 1] };
}

export function channelOf(state, point) {
  let low = 0, high = state.channels;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (state.start[middle] <= point) low = middle; else high = middle;
  }
  return low;
}

export function facts(state, channel) {
  const [first, stop] = [state.start[channel], state.start[channel + 1]];
  const xy = state.xy;
  let length = 0;
  for (let i = first + 1; i < stop; i++) length += Math.hypot(xy[2 * i] - xy[2 * i - 2], xy[2 * i + 1] - xy[2 * i - 1]);
  const chord = Math.hypot(xy[2 * stop - 2] - xy[2 * first], xy[2 * stop - 1] - xy[2 * first + 1]);
  const [width, depth, discharge, order] = state.size.subarray(4 * channel, 4 * channel + 4);
  return { id: state.id[channel], width, depth, discharge, order, length, sinuosity: chord > 0 ? length / chord : NaN, points: stop - first };
}

/** The course that MovePoint would give a channel, as (x, y) pairs: by (1 - t^2)^3 of the way. */
export function moved(state, channel, point, dx, dy, radius) {
  const [first, stop] = [state.start[channel], state.start[channel + 1]], xy = state.xy;
  const out = [];
  const arc = new Float64Array(stop - first);
  for (let i = first + 1; i < stop; i++) arc[i - first] = arc[i - first - 1] + Math.hypot(xy[2 * i] - xy[2 * i - 2], xy[2 * i + 1] - xy[2 * i - 1]);
  const here = arc[point - first], up = Math.min(radius, here) || radius, down = Math.min(radius, arc[arc.length - 1] - here) || radius;
  for (let i = first; i < stop; i++) {
    const s = arc[i - first] - here, t = Math.abs(s) / (s < 0 ? up : down);
    const w = t < 1 ? (1 - t * t) ** 3 : 0;
    out.push([xy[2 * i] + w * dx, xy[2 * i + 1] + w * dy]);
  }
  return out;
}

"use strict";
// A picture of surfaces on a 2D canvas, without WebGL: filled pixel by pixel, each pixel with its
// distance, so that surfaces hide each other rightly whatever their order and wherever they cross.
function surfaceLayer() {
  const LIGHT = [-0.41, -0.5, 0.76], AMBIENT = 0.55; // right, down, towards the viewer
  const canvas = document.createElement("canvas"), pen = canvas.getContext("2d");
  let image, width = 0, height = 0;
  let pixels, depths, owners; // row by row
  let top, bottom, west, east; // rows and columns with anything in them

  function clear(newWidth, newHeight) {
    if (width !== newWidth || height !== newHeight) {
      width = canvas.width = newWidth;
      height = canvas.height = newHeight;
      image = pen.createImageData(width, height);
      pixels = new Uint32Array(image.data.buffer);
      depths = new Float32Array(pixels.length);
      owners = new Uint16Array(pixels.length);
    }
    pixels.fill(0);
    depths.fill(-Infinity);
    owners.fill(0);
    [top, bottom, west, east] = [height, 0, width, 0];
  }

  // zx and zy are how fast a triangle comes nearer to the right and downwards, so that its normal
  // is (-zx, -zy, 1): whichever side is seen faces the viewer, and no mesh needs to be closed.
  function shaded(color, zx, zy) {
    const facing = (LIGHT[2] - zx * LIGHT[0] - zy * LIGHT[1]) / Math.sqrt(zx * zx + zy * zy + 1);
    const shade = AMBIENT + (1 - AMBIENT) * Math.max(0, facing);
    const red = color[0] * shade, green = color[1] * shade, blue = color[2] * shade;
    return (0xff000000 | (blue << 16) | (green << 8) | red) >>> 0;
  }

  // What a pixel becomes behind a share of another one.
  function mixed(behind, front, share) {
    if (!behind) return ((front & 0xffffff) | ((255 * share) << 24)) >>> 0;
    const mix = (shift) => {
      const [a, b] = [(behind >>> shift) & 255, (front >>> shift) & 255];
      return (a + (b - a) * share) << shift;
    };
    return (0xff000000 | mix(16) | mix(8) | mix(0)) >>> 0;
  }

  // Corners start at i, j, k of p, in pixels: right, down, towards the viewer. What lets others
  // through, with a share of less than 1, comes last.
  function triangle(p, i, j, k, color, owner, share = 1) {
    const colors = pixels, nearest = depths, names = owners, columns = width; // faster when local
    let swap; // a is the top corner, c the bottom one
    if (p[j + 1] < p[i + 1]) { swap = i; i = j; j = swap; }
    if (p[k + 1] < p[j + 1]) { swap = j; j = k; k = swap; }
    if (p[j + 1] < p[i + 1]) { swap = i; i = j; j = swap; }
    const ax = p[i], ay = p[i + 1], az = p[i + 2];
    const bx = p[j] - ax, by = p[j + 1] - ay, bz = p[j + 2] - az;
    const cx = p[k] - ax, cy = p[k + 1] - ay, cz = p[k + 2] - az;
    const area = bx * cy - by * cx;
    if (Math.abs(area) < 1e-6) return;
    const zx = (bz * cy - cz * by) / area, zy = (cz * bx - bz * cx) / area;
    const pixel = shaded(color, zx, zy);
    const first = Math.max(0, Math.ceil(ay - 0.5));
    const last = Math.min(height - 1, Math.floor(p[k + 1] - 0.5));
    top = Math.min(top, first); bottom = Math.max(bottom, last);
    west = Math.min(west, ax, p[j], p[k]); east = Math.max(east, ax, p[j], p[k]);
    for (let row = first; row <= last; row++) {
      const y = row + 0.5 - ay, one = (cx / cy) * y;
      const other = y < by ? (bx / by) * y : bx + ((cx - bx) / (cy - by)) * (y - by);
      const from = Math.max(0, Math.ceil(ax + Math.min(one, other) - 0.5));
      const to = Math.min(columns - 1, Math.floor(ax + Math.max(one, other) - 0.5));
      let z = az + zx * (from + 0.5 - ax) + zy * y;
      for (let at = row * columns + from, end = row * columns + to; at <= end; at++, z += zx)
        if (z > nearest[at]) {
          nearest[at] = z;
          colors[at] = share < 1 ? mixed(colors[at], pixel, share) : pixel;
          names[at] = owner;
        }
    }
  }

  // Darkens the nearer side where one owner ends, or the distance jumps by more than a step.
  function outline(step) {
    const compare = (at, other) => {
      const jump = depths[at] - depths[other];
      if (owners[at] === owners[other] && !(Math.abs(jump) > step)) return;
      const nearer = jump > 0 ? at : other;
      pixels[nearer] = (0xff000000 | ((pixels[nearer] >>> 1) & 0x7f7f7f)) >>> 0;
    };
    const first = Math.max(1, Math.floor(west)), last = Math.min(width - 1, Math.ceil(east));
    for (let y = Math.max(1, top); y <= Math.min(height - 1, bottom + 1); y++)
      for (let x = first, at = y * width + x; x <= last; x++, at++) {
        compare(at, at - 1);
        compare(at, at - width);
      }
  }

  function paint(target, width, height, opacity) {
    pen.putImageData(image, 0, 0);
    target.globalAlpha = opacity;
    target.drawImage(canvas, 0, 0, width, height);
    target.globalAlpha = 1;
  }

  return { clear, triangle, outline, paint };
}

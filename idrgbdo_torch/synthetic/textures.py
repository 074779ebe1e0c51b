"""Procedural albedo textures: (h, w, 3) float32 display values 0..1; `density` (texels/m) sizes features in metres."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.float32]
Rng = np.random.Generator


def fractal(h: int, w: int, rng: Rng, coarsest: float, persistence: float = 0.75) -> Image:
    """(h, w) noise of mean 0 and standard deviation 1, octaves from `coarsest` texels down to 1.5: about 1/f."""
    total = np.zeros((h, w), np.float32)
    size, amplitude = coarsest, 1.0
    while size >= 1.5:
        rows, cols = int(np.ceil(h / size)) + 3, int(np.ceil(w / size)) + 3
        grid = rng.standard_normal((rows, cols)).astype(np.float32)
        shift = rng.uniform(0.5, 1.5, 2)
        A = np.array([[1 / size, 0, shift[0]], [0, 1 / size, shift[1]]])
        total += amplitude * cv2.warpAffine(grid, A, (w, h), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
        size, amplitude = size / 2, amplitude * persistence
    return np.asarray((total - total.mean()) / max(float(total.std()), 1e-6), np.float32)


def tinted(noise: Image, color: npt.ArrayLike, contrast: float) -> Image:
    """A colour modulated by noise: (h, w, 3)."""
    return np.clip(np.asarray(color, np.float32) * (1 + contrast * noise[..., None]), 0.02, 0.98).astype(np.float32)


def random_color(rng: Rng, low: float = 0.1, high: float = 0.9, saturation: float = 0.6) -> Image:
    """(3,) a colour of random brightness, pulled towards gray by 1 - saturation."""
    c = rng.uniform(low, high, 3)
    return np.asarray(c.mean() + saturation * (c - c.mean()), np.float32)


def plain(h: int, w: int, rng: Rng, density: float, color: npt.ArrayLike, contrast: float = 0.02) -> Image:
    """A painted surface: a colour with weak, large stains."""
    small = fractal(max(h // 8, 2), max(w // 8, 2), rng, max(0.5 * density / 8, 2.0), 0.5)
    return tinted(cv2.resize(small, (w, h), interpolation=cv2.INTER_LINEAR), color, contrast)


def rough(h: int, w: int, rng: Rng, density: float, color: npt.ArrayLike, contrast: float = 0.2) -> Image:
    """Plaster, carpet, stone: 1/f noise from 0.3 m down."""
    return tinted(fractal(h, w, rng, max(0.3 * density, 2.0)), color, contrast)


def wood(h: int, w: int, rng: Rng, density: float, color: npt.ArrayLike) -> Image:
    """Boards 12 cm wide with a grain along the columns."""
    squeezed = fractal(h, max(w // 12, 2), rng, max(0.08 * density, 2.0))
    grain = cv2.resize(squeezed, (w, h), interpolation=cv2.INTER_LINEAR)
    board = (np.arange(h) / (0.12 * density)).astype(int)
    shade = (1 + 0.12 * rng.standard_normal(board.max() + 1)).astype(np.float32)[board]
    seam = np.where(np.diff(board, prepend=board[0]) > 0, 0.45, 1.0).astype(np.float32)
    boards = tinted(grain, color, 0.16) * (shade * seam)[:, None, None]
    return np.asarray(np.clip(boards, 0, 1), np.float32)


def checker(h: int, w: int, rng: Rng, density: float, period_m: float = 0.04) -> Image:
    """Chess board of two colours with some wear."""
    step = max(period_m * density, 3.0)
    odd = ((np.arange(h) // step)[:, None] + (np.arange(w) // step)[None]) % 2
    a, b = random_color(rng, 0.05, 0.4), random_color(rng, 0.55, 0.95)
    image = np.where(odd[..., None] > 0, a, b).astype(np.float32)
    return np.asarray(tinted(fractal(h, w, rng, max(0.1 * density, 2.0)), 1.0, 0.06) * image, np.float32)


def stripes(h: int, w: int, rng: Rng, density: float) -> Image:
    """Bands of random widths and colours along the rows, as on tins and balls."""
    image = tinted(fractal(h, w, rng, max(0.1 * density, 2.0)), np.ones(3), 0.05)
    edges = np.sort(rng.integers(0, h, int(rng.integers(3, 8))))
    for top, bottom in zip(np.r_[0, edges], np.r_[edges, h], strict=True):
        image[top:bottom] *= random_color(rng)
    return image


def write_text(image: Image, rng: Rng, density: float, line_m: float, color: npt.ArrayLike) -> None:
    """Rows of word-like marks over the whole image, in place."""
    h, w = image.shape[:2]
    step = max(int(line_m * density), 4)
    tone = tuple(float(c) for c in np.asarray(color))
    for y in range(step, h - step // 2, step):
        x = step * float(rng.uniform(0.3, 1.2))
        end = w - step * rng.uniform(0.3, 4.0)
        while x < end:
            length = step * float(rng.uniform(0.25, 0.9))
            stroke = max(step // 6, 1)
            for k in np.arange(x, min(x + length, end), max(step * 0.22, 1.6)):
                top = y - step * float(rng.uniform(0.25, 0.6))
                slant = int(rng.integers(-1, 2) * step * 0.12)
                cv2.line(image, (int(k), int(top)), (int(k) + slant, y), tone, stroke, cv2.LINE_AA)
            x += length + step * 0.35


def poster(h: int, w: int, rng: Rng, density: float) -> Image:
    """A print: a picture of random shapes over a gradient, a photograph-like patch, or a page of text."""
    style = rng.random()
    if style < 0.2:
        image = tinted(fractal(h, w, rng, max(h / 3, 2.0)), random_color(rng, 0.75, 0.95, 0.2), 0.02)
        write_text(image, rng, density, float(rng.uniform(0.012, 0.03)), random_color(rng, 0.05, 0.25))
    elif style < 0.5:
        channels = [fractal(h, w, rng, max(max(h, w) / 2.5, 2.0)) for _ in range(2)]
        mix = rng.normal(0, 0.12, (2, 3))
        image = random_color(rng, 0.3, 0.7) + sum(c[..., None] * m for c, m in zip(channels, mix, strict=True))
        image = np.clip(image, 0.03, 0.97).astype(np.float32)
    else:
        image = tinted(fractal(h, w, rng, max(h / 2, 2.0), 0.5), random_color(rng, 0.3, 0.9), 0.12)
        draw_shapes(image, rng, int(rng.integers(6, 18)))
        band = image[int(h * 0.78) : int(h * 0.95)]
        if min(band.shape[:2]) > 8:
            write_text(band, rng, density, float(rng.uniform(0.02, 0.05)), random_color(rng, 0.0, 0.9))
    border = max(int(0.008 * density), 1)
    cv2.rectangle(image, (0, 0), (w - 1, h - 1), tuple(map(float, random_color(rng, 0.05, 0.95, 0.3))), border)
    return image


def draw_shapes(image: Image, rng: Rng, count: int) -> None:
    """Filled circles, rotated rectangles, triangles and strokes, in place."""
    h, w = image.shape[:2]
    size = min(h, w)
    for _ in range(count):
        color = tuple(float(c) for c in random_color(rng))
        center = (int(rng.integers(0, w)), int(rng.integers(0, h)))
        r = float(size * rng.uniform(0.04, 0.22))
        shape = int(rng.integers(0, 4))
        if shape == 0:
            cv2.circle(image, center, max(int(r), 1), color, -1, cv2.LINE_AA)
        elif shape < 3:
            box = cv2.boxPoints((center, (2 * r, r * float(rng.uniform(0.3, 2))), float(rng.uniform(0, 180))))
            cv2.fillConvexPoly(image, box[: 5 - shape].astype(np.int32), color, cv2.LINE_AA)
        else:
            angle, reach = rng.uniform(0, 2 * np.pi), 2.5 * r
            end = (int(center[0] + reach * np.cos(angle)), int(center[1] + reach * np.sin(angle)))
            cv2.line(image, center, end, color, max(int(r / 6), 1), cv2.LINE_AA)


def label(h: int, w: int, rng: Rng, density: float) -> Image:
    """A tin's: stripes, shapes and a line of text."""
    image = stripes(h, w, rng, density)
    draw_shapes(image, rng, 5)
    write_text(image[h // 3 : 2 * h // 3], rng, density, 0.02, random_color(rng, 0.0, 1.0))
    return image


def cover(h: int, w: int, rng: Rng, density: float) -> Image:
    """A book's or a carton's printed face: colour, a frame or band, a title, a small picture."""
    base = random_color(rng, 0.1, 0.85, 0.8)
    image = tinted(fractal(h, w, rng, max(0.1 * density, 2.0)), base, 0.05)
    ink = (1.0 - base if abs(float(base.mean()) - 0.5) > 0.15 else np.full(3, 0.95)).astype(np.float32)
    if min(h, w) < 12:
        image[:, w // 5 : w // 4 + 1] = ink
        image[:, 2 * w // 3 : 2 * w // 3 + max(w // 12, 1)] = random_color(rng)
        return image
    top, bottom = int(h * rng.uniform(0.1, 0.3)), int(h * rng.uniform(0.4, 0.6))
    image[top:bottom, int(w * 0.08) : int(w * 0.92)] = random_color(rng, 0.2, 0.9)
    draw_shapes(image[bottom : int(h * 0.9), int(w * 0.1) : int(w * 0.9)], rng, int(rng.integers(2, 7)))
    write_text(image[top:bottom], rng, density, float(rng.uniform(0.02, 0.04)), ink)
    return image


def spines(h: int, w: int, rng: Rng, density: float) -> Image:
    """Rows of book backs on shelves 0.32 m apart."""
    image = np.empty((h, w, 3), np.float32)
    image[:] = random_color(rng, 0.05, 0.2, 0.3)
    shelf = max(int(0.32 * density), 6)
    board = max(shelf // 14, 1)
    wooden = random_color(rng, 0.4, 0.7, 0.4)
    for top in range(0, h, shelf):
        bottom = min(top + shelf, h)
        x = board
        while x < w - board:
            width = max(int(density * rng.uniform(0.015, 0.055)), 2)
            tall = int((bottom - top) * rng.uniform(0.6, 0.92))
            right = min(x + width, w - board)
            if rng.random() < 0.92 and tall > 3 and right > x:
                back = image[bottom - tall : bottom, x:right]
                back[:] = random_color(rng, 0.08, 0.9, 0.8)
                for y in (0.15, 0.5, 0.8):
                    height = max(int(tall * rng.uniform(0.02, 0.12)), 1)
                    back[int(tall * y) : int(tall * y) + height] = random_color(rng)
            x = right + 1
        image[bottom - board : bottom] = wooden
    image[:, :board] = image[:, -board:] = wooden
    return image


def pinned(image: Image, rng: Rng, density: float, per_m2: float, low_m: float, high_m: float) -> Image:
    """The image with prints pinned onto it at random places and slight angles."""
    h, w = image.shape[:2]
    for _ in range(round(per_m2 * h * w / density**2)):
        rows, cols = (int(density * rng.uniform(low_m, high_m)) for _ in range(2))
        if min(rows, cols) < 6 or rows + 4 > h or cols + 4 > w:
            continue
        sheet = poster(rows, cols, rng, density)
        angle = np.deg2rad(rng.normal(0, 4))
        c, s = np.cos(angle), np.sin(angle)
        x, y = rng.uniform(0, w - cols), rng.uniform(0, h - rows)
        pad = int(0.1 * (rows + cols))
        x0, y0 = max(int(x) - pad, 0), max(int(y) - pad, 0)
        view = image[y0 : int(y) + rows + pad, x0 : int(x) + cols + pad]
        A = np.array([[c, -s, x - x0], [s, c, y - y0]])
        size = (view.shape[1], view.shape[0])
        mask = cv2.warpAffine(np.ones((rows, cols), np.float32), A, size, flags=cv2.INTER_LINEAR)[..., None]
        view[:] = view * (1 - mask) + cv2.warpAffine(sheet, A, size, flags=cv2.INTER_LINEAR)
    return image

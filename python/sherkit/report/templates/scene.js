// <sherkit-scene data-scene="…">: a machine, or the errors of a run, in three dimensions on a canvas. It asks for nothing
// outside the page. The picture within the element is what print and readers without JavaScript see.
(() => {
"use strict"
if (customElements.get("sherkit-scene")) return
const STYLE = `
:host { display: block; position: relative; max-width: 100%; color-scheme: light dark;
  --ink: #222; --muted: #666; --paper: #fff; --rule: #d9d9d9; --pale: #b5b5b5; --now: #0072b2; --off: #d55e00 }
@media (prefers-color-scheme: dark) { :host { --ink: #e8e8e8; --muted: #a5a5a5; --paper: #16181b; --rule: #444;
  --pale: #686868; --now: #56b4e9; --off: #f0874a } }
canvas { width: 100%; display: block; background: var(--paper); border: 1px solid var(--rule); cursor: grab;
  touch-action: pan-y; box-sizing: border-box }
canvas:active { cursor: grabbing } canvas:focus-visible { outline: 3px solid var(--now); outline-offset: 1px }
.controls { display: flex; flex-wrap: wrap; gap: 4px 18px; align-items: center; font: 15px/1.6 sans-serif; color: var(--ink) }
label { display: flex; flex-wrap: wrap; gap: 0 8px; align-items: center; max-width: 100% } input[type=range] { width: 170px; accent-color: var(--now) }
.view { position: relative } .zoom { position: absolute; right: 6px; top: 6px; display: flex; gap: 4px }
.zoom button { font: 17px/1 sans-serif; width: 28px; height: 28px; padding: 0; color: var(--ink); background: var(--paper);
  border: 1px solid var(--rule); border-radius: 3px } .zoom button:focus-visible { outline: 3px solid var(--now) }
output { min-width: 4.2em; font-variant-numeric: tabular-nums }
.tip { position: absolute; pointer-events: none; display: none; font: 14px/1.35 sans-serif; color: var(--ink);
  background: var(--paper); border: 1px solid var(--muted); padding: 3px 7px; white-space: pre; z-index: 2 }
.still { display: none }
@media print { .view, .controls, .tip { display: none !important } .still { display: block } }`
const LOOK = {  // width, colour, size of dots
  guide: [1, "--rule", 0], frame: [3, "--muted", 0], axis: [1, "--muted", 0], rod: [2.2, "--now", 0],
  link: [4.5, "--ink", 0], platform: [3, "--now", 0], joint: [1, "--ink", 4], sensor: [1.6, "--muted", 0],
  ray: [1.6, "--off", 0], target: [1, "--now", 6], shown: [1, "--off", 6]
}
const floats = text => new Float32Array(Uint8Array.from(atob(text), c => c.charCodeAt(0)).buffer)
const digits = v => v >= 100 ? v.toFixed(0) : v >= 10 ? v.toFixed(1) : v >= 1 ? v.toFixed(2) : v.toPrecision(2)

class Scene extends HTMLElement {
  connectedCallback() {
    if (this.shadowRoot) return
    const s = this.scene = JSON.parse(this.dataset.scene)
    const root = this.attachShadow({mode: "open"})
    root.innerHTML = `<style>${STYLE}</style><div class="view"><canvas tabindex="0" role="img"></canvas>
      <div class="zoom"></div></div><div class="tip"></div><div class="controls"></div><div class="still"><slot></slot></div>`
    this.canvas = root.querySelector("canvas")
    this.canvas.setAttribute("aria-label", s.label + ". Arrow keys turn it, plus and minus zoom.")
    this.tip = root.querySelector(".tip")
    this.bar = root.querySelector(".controls")
    this.yaw = s.view[0]; this.pitch = s.view[1]; this.zoom = 1
    s.frames = s.frames.map(f => ({at: f.at, p: floats(f.p)}))
    if (s.arrows) s.arrows = {...s.arrows, where: floats(s.arrows.where), errors: s.arrows.errors.map(floats),
      line: floats(s.arrows.line), worst: s.arrows.worst.map(floats)}
    if (s.field) s.field = {...s.field, where: floats(s.field.where), value: floats(s.field.value)}
    this.at = s.begin; this.moment = s.moment; this.slab = -1; this.showField = false
    // poses that a person chose elsewhere on the page, by their lines
    window.addEventListener("sherkit-chosen", () => this.ask())
    this.controls()
    this.listen()
    new ResizeObserver(() => this.ask()).observe(this.canvas)
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { this.colours = null; this.ask() })
  }
  ask() { if (!this.asked) this.asked = requestAnimationFrame(() => { this.asked = 0; this.draw() }) }
  control(text, input, says) {
    const label = document.createElement("label"), out = document.createElement("output")
    label.append(text, input, out)
    const show = () => { out.textContent = says(); this.ask() }
    input.addEventListener("input", show)
    this.bar.append(label)
    show()
  }
  range(min, max, step, value, set) {
    const input = Object.assign(document.createElement("input"), {type: "range", min, max, step, value})
    input.value = value
    input.addEventListener("input", () => set(+input.value))
    return input
  }
  controls() {
    const s = this.scene, last = s.frames.length - 1
    if (last > 0) {
      const top = Math.log10(s.frames[last].at)
      if (top > 0) this.control("exaggerated", this.range(0, top, 0.01, Math.log10(this.at), v => { this.at = 10 ** v }),
        () => "× " + digits(this.at).replace(/\.0+$/, ""))
    }
    const a = s.arrows
    if (a && a.errors.length > 1)
      this.control(a.titles[0], this.range(0, a.errors.length - 1, 0.02, this.moment, v => { this.moment = v }),
        () => a.titles[a.titles.length - 1])
    if (a && a.slabs.length > 1)
      this.control(a.height, this.range(-1, a.slabs.length - 1, 1, -1, v => { this.slab = v }),
        () => this.slab < 0 ? "all" : a.slabs[this.slab][2])
    if (s.field) {
      const box = Object.assign(document.createElement("input"), {type: "checkbox"})
      box.addEventListener("input", () => { this.showField = box.checked })
      this.control(s.field.title, box, () => `${digits(s.field.low)} to ${digits(s.field.high)} ${s.field.unit}`)
    }
    for (const [text, what, by] of [["+", "nearer", 1.25], ["−", "farther", 0.8], ["⌂", "as it was", 0]]) {
      const button = Object.assign(document.createElement("button"), {textContent: text, title: what})
      button.setAttribute("aria-label", what)
      button.addEventListener("click", () => { this.zoomed(by) })
      this.shadowRoot.querySelector(".zoom").append(button)
    }
  }
  zoomed(by) {
    if (by) this.zoom = Math.min(20, Math.max(0.3, this.zoom * by))
    else { this.zoom = 1; [this.yaw, this.pitch] = this.scene.view }
    this.ask()
  }
  turned(dx, dy) { this.yaw += dx; this.pitch = Math.max(-1.57, Math.min(1.57, this.pitch + dy)); this.ask() }
  listen() {
    const c = this.canvas
    let held = null
    c.addEventListener("pointerdown", e => { held = [e.clientX, e.clientY]; c.setPointerCapture(e.pointerId); this.hide() })
    c.addEventListener("pointerup", () => { held = null })
    c.addEventListener("pointermove", e => {
      if (!held) return this.hover(e)
      this.turned((e.clientX - held[0]) * 0.008, (e.clientY - held[1]) * 0.008)
      held = [e.clientX, e.clientY]
    })
    c.addEventListener("pointerleave", () => this.hide())
    // who only scrolls past scrolls the page
    c.addEventListener("wheel", e => {
      if (this.shadowRoot.activeElement !== c && !e.ctrlKey) return
      e.preventDefault()
      this.zoomed(Math.exp(-e.deltaY * 0.0015))
    }, {passive: false})
    const keys = {ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1]}
    c.addEventListener("keydown", e => {
      if (keys[e.key]) this.turned(...keys[e.key])
      else if (e.key === "+" || e.key === "-") this.zoomed(e.key === "+" ? 1.25 : 0.8)
      else return
      e.preventDefault()
    })
  }
  hide() { this.tip.style.display = "none" }
  // the points of the parts with as much of the effect as the slider says: between two drawings, straight on
  points() {
    const frames = this.scene.frames, k = Math.max(1, frames.findIndex(f => f.at >= this.at - 1e-9))
    if (frames.length < 2) return frames[0].p
    const a = frames[k - 1], b = frames[k], t = (this.at - a.at) / (b.at - a.at), out = new Float32Array(a.p.length)
    for (let i = 0; i < out.length; i++) out[i] = a.p[i] + t * (b.p[i] - a.p[i])
    return out
  }
  project(p, out) {
    const [cx, cy, cz] = this.scene.centre, sy = Math.sin(this.yaw), cyw = Math.cos(this.yaw)
    const sp = Math.sin(this.pitch), cp = Math.cos(this.pitch), k = this.scale, w = this.w / 2, h = this.h / 2
    for (let i = 0, j = 0; i < p.length; i += 3, j += 2) {
      const x = p[i] - cx, y = p[i + 1] - cy, z = p[i + 2] - cz, depth = -sy * x + cyw * y
      out[j] = w + k * (cyw * x + sy * y)
      out[j + 1] = h - k * (cp * z + sp * depth)
    }
    return out
  }
  palette() {
    if (!this.colours) {
      const style = getComputedStyle(this)
      this.colours = new Proxy({}, {get: (held, name) => held[name] ??= style.getPropertyValue(name).trim()})
    }
    return this.colours
  }
  draw() {
    const s = this.scene, c = this.canvas, ratio = devicePixelRatio || 1
    this.w = c.clientWidth || s.width; this.h = Math.round(this.w * s.aspect)
    c.style.height = this.h + "px"
    if (c.width !== Math.round(this.w * ratio)) { c.width = Math.round(this.w * ratio); c.height = Math.round(this.h * ratio) }
    const g = this.g = c.getContext("2d"), colour = this.palette()
    g.setTransform(ratio, 0, 0, ratio, 0, 0)
    g.clearRect(0, 0, this.w, this.h)
    g.lineCap = g.lineJoin = "round"
    this.scale = this.zoom * Math.min(this.w, this.h) / s.size
    if (s.field && this.showField) this.drawField()
    if (s.frames.length) {
      if (s.frames.length > 1) this.drawParts(s.frames[0].p, () => colour["--pale"], 0.75)
      // where errors are shown the machine stands behind them
      this.drawParts(this.points(), look => colour[s.arrows ? "--pale" : LOOK[look][1]], 1)
    }
    if (s.arrows) this.drawArrows()
    this.drawAxes()
  }
  drawParts(p, of, thin) {
    const g = this.g, xy = this.project(p, new Float32Array(p.length / 3 * 2))
    let at = 0
    for (const [name, look, n] of this.scene.parts) {
      const [width, , dot] = LOOK[look]
      g.strokeStyle = g.fillStyle = of(look)
      g.lineWidth = width * thin
      g.beginPath()
      if (dot) g.arc(xy[2 * at], xy[2 * at + 1], dot * thin, 0, 7)
      else for (let i = 0; i < n; i++) g.lineTo(xy[2 * (at + i)], xy[2 * (at + i) + 1])
      if (look === "platform" && thin === 1 && n > 3) { g.globalAlpha = 0.18; g.fill(); g.globalAlpha = 1 }
      if (dot) look === "shown" ? (g.lineWidth = 2.5 * thin, g.stroke()) : g.fill()
      else g.stroke()
      at += n
    }
  }
  drawField() {
    const g = this.g, f = this.scene.field, xy = this.project(f.where, new Float32Array(f.value.length * 2))
    const size = Math.max(2, f.cell * this.scale * 0.8)
    for (let i = 0; i < f.value.length; i++) {
      if (!this.inSlab(f.where[3 * i + 2])) continue
      const t = Math.min(1, Math.max(0, (f.value[i] - f.low) / (f.high - f.low || 1)))
      g.fillStyle = `rgba(${Math.round(150 - 75 * t)},${Math.round(205 - 159 * t)},${Math.round(220 - 89 * t)},0.45)`
      g.fillRect(xy[2 * i] - size / 2, xy[2 * i + 1] - size / 2, size, size)
    }
  }
  inSlab(z) {
    if (this.slab < 0 || !this.scene.arrows) return true
    const [low, high] = this.scene.arrows.slabs[this.slab]
    return z >= low && z <= high
  }
  // errors at this moment, mm: between two states, straight on
  errors() {
    const e = this.scene.arrows.errors, k = Math.floor(this.moment), t = this.moment - k
    if (t < 1e-9) return e[k]
    const out = new Float32Array(e[k].length)
    for (let i = 0; i < out.length; i++) out[i] = e[k][i] + t * (e[k + 1][i] - e[k][i])
    return out
  }
  drawArrows() {
    const g = this.g, a = this.scene.arrows, n = a.line.length, colour = this.palette(), e = this.errors()
    const ends = new Float32Array(3 * n), big = a.bar * 2
    for (let i = 0; i < 3 * n; i++) ends[i] = a.where[i] + a.times * e[i]
    const from = this.from = this.project(a.where, new Float32Array(2 * n))
    const to = this.project(ends, new Float32Array(2 * n))
    // by size in so many colours, each drawn in one go
    const chosen = new Set(window.sherkitChosen ?? []), groups = Array.from({length: 12}, () => [])
    for (let i = 0; i < n; i++) {
      if (!this.inSlab(a.where[3 * i + 2])) continue
      const size = Math.hypot(e[3 * i], e[3 * i + 1], e[3 * i + 2]), aside = chosen.size && !chosen.has(a.line[i])
      groups[Math.min(5, Math.floor(6 * size / big)) + (aside ? 0 : 6)].push(i)
    }
    const inks = ["#56b4e9", "#3a95cf", "#0072b2", "#8a6a6a", "#d55e00", "#c03000"]
    groups.forEach((group, k) => {
      if (!group.length) return
      g.strokeStyle = g.fillStyle = inks[k % 6]
      g.globalAlpha = k < 6 ? 0.18 : 1
      g.lineWidth = n > 1000 ? 1 : 1.5
      // round ends of thousands of lines are most of what drawing them costs
      g.lineCap = "butt"
      g.lineJoin = "bevel"
      g.beginPath()
      for (const i of group) {
        const x = to[2 * i], y = to[2 * i + 1], dx = x - from[2 * i], dy = y - from[2 * i + 1], l = Math.hypot(dx, dy)
        g.moveTo(from[2 * i], from[2 * i + 1]); g.lineTo(x, y)
        if (l > (n > 1000 ? 9 : 5)) {
          const b = Math.min(6, 0.4 * l) / l
          g.moveTo(x - b * (dx + 0.5 * dy), y - b * (dy - 0.5 * dx)); g.lineTo(x, y)
          g.lineTo(x - b * (dx - 0.5 * dy), y - b * (dy + 0.5 * dx))
        }
      }
      g.stroke()
      g.beginPath()
      for (const i of group) g.rect(from[2 * i] - 1, from[2 * i + 1] - 1, 2, 2)
      g.fill()
    })
    g.globalAlpha = 1
    g.strokeStyle = g.fillStyle = colour["--off"]
    g.lineWidth = 2
    g.font = "13px sans-serif"
    for (const i of a.worst[Math.round(this.moment)]) {
      if (!this.inSlab(a.where[3 * i + 2])) continue
      g.beginPath(); g.arc(from[2 * i], from[2 * i + 1], 8, 0, 7); g.stroke()
      g.fillText(a.line[i], from[2 * i] + 10, from[2 * i + 1] - 7)
    }
    const long = a.bar * a.times * this.scale, y = this.h - 22
    g.strokeStyle = g.fillStyle = colour["--ink"]
    g.beginPath(); g.moveTo(16, y); g.lineTo(16 + long, y); g.stroke()
    g.font = "15px sans-serif"
    const said = v => digits(v * a.perUnit).replace(/\.0+$/, "")
    g.fillText(`${said(a.bar)} ${a.unit}`, 22 + long, y + 5)
    // what the colours say, where there is room for it
    if (this.w < 520) return
    const end = `${said(big)} ${a.unit} and more`, left = this.w - 216 - g.measureText(end).width
    g.fillText("0", left - 14, y + 5)
    inks.forEach((ink, k) => { g.fillStyle = ink; g.fillRect(left + 16 * k, y - 6, 16, 12) })
    g.fillStyle = colour["--ink"]
    g.fillText(end, left + 102, y + 5)
  }
  drawAxes() {
    const g = this.g, s = this.scene, colour = this.palette(), k = this.scale, [cx, cy, cz] = s.centre
    const l = 30 / k, p = new Float32Array([cx, cy, cz, cx + l, cy, cz, cx, cy + l, cz, cx, cy, cz + l])
    const xy = this.project(p, new Float32Array(8)), ox = this.w - 48 - xy[0], oy = this.h - 48 - xy[1]
    g.strokeStyle = g.fillStyle = colour["--muted"]
    g.lineWidth = 1.5
    g.font = "13px sans-serif"
    s.axes.forEach((name, i) => {
      const x = xy[2 * i + 2] + ox, y = xy[2 * i + 3] + oy
      g.beginPath(); g.moveTo(xy[0] + ox, xy[1] + oy); g.lineTo(x, y); g.stroke()
      g.fillText(name, x + (x - xy[0] - ox) * 0.25 - 3, y + (y - xy[1] - oy) * 0.25 + 4)
    })
  }
  hover(e) {
    const box = this.canvas.getBoundingClientRect(), x = e.clientX - box.left, y = e.clientY - box.top, a = this.scene.arrows
    let said = ""
    if (a && this.from) {
      let near = 14 ** 2, which = -1
      for (let i = 0; i < a.line.length; i++) {
        const d = (this.from[2 * i] - x) ** 2 + (this.from[2 * i + 1] - y) ** 2
        if (d < near && this.inSlab(a.where[3 * i + 2])) { near = d; which = i }
      }
      if (which >= 0) {
        const size = v => digits(a.perUnit * Math.hypot(v[3 * which], v[3 * which + 1], v[3 * which + 2]))
        said = `${a.counted} ${a.line[which]}\n` + a.titles.map((t, k) => `${t}: ${size(a.errors[k])} ${a.unit}`).join("\n")
      }
    }
    if (!said && this.scene.frames.length) {
      const p = this.points(), xy = this.project(p, new Float32Array(p.length / 3 * 2))
      let near = 8, at = 0
      for (const [name, , n] of this.scene.parts) {
        for (let i = 0; i < Math.max(1, n - 1); i++) {
          const j = 2 * (at + i), k = n > 1 ? j + 2 : j, ux = xy[k] - xy[j], uy = xy[k + 1] - xy[j + 1]
          const t = Math.max(0, Math.min(1, ((x - xy[j]) * ux + (y - xy[j + 1]) * uy) / (ux * ux + uy * uy || 1)))
          const d = Math.hypot(xy[j] + t * ux - x, xy[j + 1] + t * uy - y)
          if (d < near) { near = d; said = name }
        }
        at += n
      }
    }
    this.tip.textContent = said
    Object.assign(this.tip.style, {display: said ? "block" : "none", left: Math.min(x + 14, this.w - 190) + "px", top: y + 12 + "px"})
  }
}
customElements.define("sherkit-scene", Scene)
})()

// The colours of client graphics, with the values of X11, and the theme colours from the style sheet.

export const CLIENT_COLOURS = {
  Blue: '#0000ff', NavyBlue: '#000080', RoyalBlue: '#4169e1', SteelBlue: '#4682b4', CadetBlue: '#5f9ea0',
  Green: '#00ff00', SeaGreen: '#2e8b57', ForestGreen: '#228b22', DarkGreen: '#006400', LimeGreen: '#32cd32',
  Yellow: '#ffff00', Orange: '#ffa500', LightCoral: '#f08080', DeepPink: '#ff1493', OrangeRed: '#ff4500',
  Red: '#ff0000', IndianRed: '#cd5c5c', VioletRed: '#d02090', Maroon: '#b03060',
};

const NAMES = ['paper', 'panel', 'ink', 'quiet', 'edge', 'accent', 'grid', 'wall', 'obstacle', 'actual', 'encoder',
  'actual-trace', 'encoder-trace', 'sonar', 'infrared', 'laser', 'hit', 'estimate', 'good'];

const MIN_CONTRAST = 3, STEPS = 20;

// Return a client's colour for this theme. Black is the text colour, and a colour without enough contrast to the background
// is mixed with the text colour until it has: 3 to 1, as WCAG 2.2 requires for graphics.
const cache = new Map();
export function clientColour(name, theme) {
  const key = `${name} ${theme.paper} ${theme.ink}`;
  if (!cache.has(key)) cache.set(key, name in CLIENT_COLOURS ? onPaper(CLIENT_COLOURS[name], theme) : theme.ink);
  return cache.get(key);
}

function onPaper(colour, { paper, ink }) {
  const [one, other] = [parts(colour), parts(ink)];
  for (let step = 0; step <= STEPS; step += 1) {
    const mixed = one.map((part, k) => Math.round(part + (other[k] - part) * step / STEPS));
    const text = `#${mixed.map((part) => part.toString(16).padStart(2, '0')).join('')}`;
    if (contrast(text, paper) >= MIN_CONTRAST) return text;
  }
  return ink;
}

function parts(colour) { return [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16)); }

// Return the contrast ratio of two colours #rrggbb, as defined by WCAG 2.2.
export function contrast(one, other) {
  const light = (colour) => parts(colour).map((part) => part / 255)
    .map((part) => (part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4))
    .reduce((sum, part, k) => sum + part * [0.2126, 0.7152, 0.0722][k], 0);
  const [darker, lighter] = [light(one), light(other)].sort((a, b) => a - b);
  return (lighter + 0.05) / (darker + 0.05);
}

export function readTheme() {
  const style = getComputedStyle(document.documentElement);
  return Object.fromEntries(NAMES.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

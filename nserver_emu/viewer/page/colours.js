// The twenty colours of client graphics, as X had them, and the page's own from the style sheet.

export const CLIENT_COLOURS = {
  Blue: '#0000ff', NavyBlue: '#000080', RoyalBlue: '#4169e1', SteelBlue: '#4682b4', CadetBlue: '#5f9ea0',
  Green: '#00ff00', SeaGreen: '#2e8b57', ForestGreen: '#228b22', DarkGreen: '#006400', LimeGreen: '#32cd32',
  Yellow: '#ffff00', Orange: '#ffa500', LightCoral: '#f08080', DeepPink: '#ff1493', OrangeRed: '#ff4500',
  Red: '#ff0000', IndianRed: '#cd5c5c', VioletRed: '#d02090', Maroon: '#b03060',
};

const NAMES = ['paper', 'panel', 'ink', 'quiet', 'edge', 'accent', 'grid', 'wall', 'obstacle', 'actual', 'encoder',
  'actual-trace', 'encoder-trace', 'sonar', 'infrared', 'laser', 'hit', 'estimate', 'good'];

// Black is the ink of the page, so that it is seen on a dark one too.
export function clientColour(name, theme) { return CLIENT_COLOURS[name] ?? theme.ink; }

export function readTheme() {
  const style = getComputedStyle(document.documentElement);
  return Object.fromEntries(NAMES.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

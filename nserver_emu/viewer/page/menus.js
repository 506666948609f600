// Menus: popovers in the browser's top layer, below their button and inside the window. The browser opens and closes
// them (button, Escape, click elsewhere); this module only positions them. Also the menu Share.

const GAP_PX = 4, MARGIN_PX = 8;

// Return the position of a menu of the given size for the box of its button, in a window of the given size.
export function menuPosition(box, [width, height], [windowWidth, windowHeight]) {
  const clamp = (at, size, space) => Math.max(MARGIN_PX, Math.min(at, space - size - MARGIN_PX));
  const below = box.bottom + GAP_PX, fitsBelow = below + height + MARGIN_PX <= windowHeight;
  return [clamp(box.left, width, windowWidth), clamp(fitsBelow ? below : box.top - GAP_PX - height, height, windowHeight)];
}

export function setUpMenus() {
  for (const button of document.querySelectorAll('[popovertarget]')) {
    const menu = document.getElementById(button.getAttribute('popovertarget'));
    const position = () => {
      const [left, top] = menuPosition(button.getBoundingClientRect(), [menu.offsetWidth, menu.offsetHeight],
        [document.documentElement.clientWidth, document.documentElement.clientHeight]);
      menu.style.left = `${left}px`;
      menu.style.top = `${top}px`;
    };
    // The size of the menu is only known once it is open: it stays invisible until it is positioned.
    menu.addEventListener('beforetoggle', () => menu.classList.add('unplaced'));
    menu.addEventListener('toggle', (event) => {
      if (event.newState !== 'open') return;
      position();
      menu.classList.remove('unplaced');
    });
    menu.addEventListener('click', (event) => { if (event.target.closest('button:not([data-stays])')) menu.hidePopover(); });
    window.addEventListener('resize', () => { if (menu.matches(':popover-open')) menu.hidePopover(); });
  }
}

// The menu Share shows and copies the read-only link. Only pages with full access receive its token.
export function setUpSharing(app) {
  const field = document.getElementById('share-link'), copy = document.getElementById('share-copy');
  document.getElementById('share').addEventListener('beforetoggle', () => {
    field.value = linkWith(location, app.watchToken);
    copy.textContent = 'Copy link';
  });
  field.addEventListener('focus', () => field.select());
  copy.addEventListener('click', async () => {
    copy.textContent = (await copyToClipboard(field)) ? 'Copied' : 'Copy it by hand';
  });
}

export function linkWith({ origin, pathname }, token) {
  return token ? `${origin}${pathname}?token=${encodeURIComponent(token)}` : '';
}

async function copyToClipboard(field) {
  try {
    await navigator.clipboard.writeText(field.value);
    return true;
  } catch {  // browsers provide the clipboard only over https and on localhost
    field.focus();
    return document.execCommand('copy');
  }
}

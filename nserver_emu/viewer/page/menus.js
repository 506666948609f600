// Menus that open over the page, in the browser's top layer: under their button, whole inside the window. Escape, a
// press elsewhere, on the button or on one of theirs closes them; closed, they take no room. All but the place is the
// browser's.

const APART = 4, MARGIN = 8;

// Where a menu of that width and height stands for a button's box, in a window of that size.
export function menuPlace(box, [width, height], [across, down]) {
  const inside = (at, size, room) => Math.max(MARGIN, Math.min(at, room - size - MARGIN));
  const below = box.bottom + APART, fits = below + height + MARGIN <= down;
  return [inside(box.left, width, across), inside(fits ? below : box.top - APART - height, height, down)];
}

export function setUpMenus() {
  for (const button of document.querySelectorAll('[popovertarget]')) {
    const menu = document.getElementById(button.getAttribute('popovertarget'));
    const place = () => {
      const [left, top] = menuPlace(button.getBoundingClientRect(), [menu.offsetWidth, menu.offsetHeight],
        [document.documentElement.clientWidth, document.documentElement.clientHeight]);
      menu.style.left = `${left}px`;
      menu.style.top = `${top}px`;
    };
    menu.addEventListener('beforetoggle', () => menu.classList.add('unplaced'));
    menu.addEventListener('toggle', (event) => {
      if (event.newState !== 'open') return;
      place();
      menu.classList.remove('unplaced');
    });
    menu.addEventListener('click', (event) => { if (event.target.closest('button:not([data-stays])')) menu.hidePopover(); });
    window.addEventListener('resize', () => { if (menu.matches(':popover-open')) menu.hidePopover(); });
  }
}

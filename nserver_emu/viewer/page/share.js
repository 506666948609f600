// Links to this page: the one that only looks is shown and copied for who has the one that acts.

export function setUpSharing(app) {
  const field = document.getElementById('share-link'), copy = document.getElementById('share-copy');
  document.getElementById('share').addEventListener('beforetoggle', () => {
    field.value = linkWith(location, app.watchToken);
    copy.textContent = 'Copy link';
  });
  field.addEventListener('focus', () => field.select());
  copy.addEventListener('click', async () => {
    copy.textContent = (await copied(field)) ? 'Copied' : 'Select it and copy by hand';
  });
}

export function linkWith({ origin, pathname }, token) {
  return token ? `${origin}${pathname}?token=${encodeURIComponent(token)}` : '';
}

// Browsers give the clipboard to pages of loopback and of https only.
async function copied(field) {
  try {
    await navigator.clipboard.writeText(field.value);
    return true;
  } catch {
    field.focus();
    return document.execCommand('copy');
  }
}

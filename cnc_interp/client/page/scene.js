// The executed part of the path in a colour of its own, for scene.py.
window.scene = {
  show_done(scene, path, colour, corners) {
    getElement(scene).objects.get(path)?.mesh?.traverse((part) => {
      if (!part.isMesh) return;
      if (!Array.isArray(part.material)) {
        const done = part.material.clone();
        done.vertexColors = false;
        done.color.set(colour);
        part.material = [done, part.material];
      }
      part.geometry.clearGroups();
      part.geometry.addGroup(0, corners, 0);
      part.geometry.addGroup(corners, Infinity, 1);
    });
  },
};

// For scene.py: the executed part of the path in a separate colour, and the parts drawn through the machine.
window.scene = {
  // The view has the room that the jog keys leave.
  fit(scene) {
    const view = getElement(scene);
    view.fitted ??= new ResizeObserver(() => view.resize());
    view.fitted.observe(view.$el);
  },
  async show_through(scene, names) {
    const objects = getElement(scene).objects;
    for (const object of names.map((name) => objects.get(name))) {
      await object?.ready_promise;
      if (!object?.mesh) continue;
      object.mesh.material.depthTest = false;
      object.mesh.material.transparent = true; // these are drawn last
      object.mesh.renderOrder = 1;
    }
  },
  // Draw the path as a tube with this many sides, from its radius, points and colours.
  async show_path(scene, path, file, sides, done, corners_done) {
    const view = getElement(scene);
    const object = view.objects.get(path);
    if (!object) return; // the view is not ready yet
    object.done = corners_done;
    const [{ THREE }, answer] = await Promise.all([import('nicegui-scene'), fetch(file), object.ready_promise]);
    if (!answer.ok || view.objects.get(path) !== object) return; // another path is shown by now
    const data = await answer.arrayBuffer();
    const count = (data.byteLength - 4) / 16;
    const [radius, ...places] = new Float32Array(data, 0, 1 + 3 * count);
    const shades = new Uint8Array(data, 4 + 12 * count);
    const at = (k) => new THREE.Vector3().fromArray(places, 3 * k);
    const chord = (k) => at(k + 1).sub(at(k)).normalize();
    const [vertices, normals, colours, corners] = [[], [], [], []];
    const across = new THREE.Vector3();
    for (let k = 0; k < count; k++) {
      const before = chord(Math.max(k - 1, 0));
      const tangent = before.clone().add(chord(Math.min(k, count - 2)));
      if (tangent.length() < 0.1) tangent.copy(before); // the path turns back on itself
      tangent.normalize();
      across.addScaledVector(tangent, -across.dot(tangent)); // the cross section is carried along with little turning
      if (across.length() < 0.1) {
        const size = tangent.toArray().map(Math.abs);
        across.set(0, 0, 0).setComponent(size.indexOf(Math.min(...size)), 1).cross(tangent);
      }
      across.normalize();
      const beside = tangent.clone().cross(across);
      for (let side = 0; side < sides; side++) {
        const angle = (2 * Math.PI * side) / sides;
        const normal = across.clone().multiplyScalar(Math.cos(angle)).addScaledVector(beside, Math.sin(angle));
        normals.push(...normal.toArray());
        vertices.push(...at(k).addScaledVector(normal, radius).toArray());
        colours.push(...shades.subarray(4 * k, 4 * k + 4));
        if (k + 1 === count) continue;
        const [a, b] = [k * sides + side, k * sides + ((side + 1) % sides)];
        corners.push(a, b, a + sides, b, b + sides, a + sides);
      }
    }
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute('position', new THREE.Float32BufferAttribute(vertices, 3));
    geometry.setAttribute('normal', new THREE.Float32BufferAttribute(normals, 3));
    geometry.setAttribute('color', new THREE.Uint8BufferAttribute(colours, 4, true));
    geometry.setIndex(corners);
    const look = { roughness: 0.9 };
    const materials = [
      new THREE.MeshStandardMaterial({ ...look, color: done }),
      new THREE.MeshStandardMaterial({ ...look, vertexColors: true }),
    ];
    object.mesh.add(new THREE.Mesh(geometry, materials));
    this.show_done(scene, path, object.done);
    this.pickable(view, object, sides);
  },
  NEAR: 14, // distance from the pointer within which a point of the path is picked [px]
  // A press beside the path picks the point of it that is nearest on the screen.
  pickable(view, path, sides) {
    const canvas = view.renderer.domElement;
    let down = null;
    canvas.onpointerdown = (event) => (down = [event.clientX, event.clientY]);
    canvas.onclick = (event) => {
      if (!down || Math.hypot(event.clientX - down[0], event.clientY - down[1]) > 4) return; // it was turned
      const box = canvas.getBoundingClientRect();
      let best = this.NEAR;
      let point = -1;
      path.mesh.traverse((part) => {
        if (!part.isMesh) return;
        const vertices = part.geometry.attributes.position;
        const place = part.position.clone();
        for (let i = 0; i < vertices.count; i += sides) {
          place.fromBufferAttribute(vertices, i).applyMatrix4(part.matrixWorld).project(view.camera);
          const x = box.left + (0.5 + place.x / 2) * box.width - event.clientX;
          const y = box.top + (0.5 - place.y / 2) * box.height - event.clientY;
          if (Math.hypot(x, y) < best) [best, point] = [Math.hypot(x, y), i / sides];
        }
      });
      if (point >= 0) emitEvent('pick_point', { point });
    };
  },
  show_done(scene, path, corners) {
    const object = getElement(scene).objects.get(path);
    if (!object) return;
    object.done = corners; // if the tube is not drawn yet
    object.mesh?.traverse((part) => {
      if (!part.isMesh) return;
      part.geometry.clearGroups();
      part.geometry.addGroup(0, corners, 0);
      part.geometry.addGroup(corners, Infinity, 1);
    });
  },
};

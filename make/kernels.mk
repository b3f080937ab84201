# The kernels on hostile inputs under ASan + UBSan (those for a GPU emulated), and under TSan; their instructions counted.
.PHONY: sanitize sanitize-address sanitize-thread count

sanitize: sanitize-address sanitize-thread

sanitize-address: install
	$(BIN)/cmake -S csrc/tests -B build/asan -DFOURD_SANITIZE=address,undefined -G "Unix Makefiles" -DCMAKE_BUILD_TYPE=Debug >/dev/null
	$(BIN)/cmake --build build/asan
	build/asan/hostile 300
	build/asan/hostile_gpu 100

sanitize-thread: install
	$(BIN)/cmake -S csrc/tests -B build/tsan -DFOURD_SANITIZE=thread -G "Unix Makefiles" -DCMAKE_BUILD_TYPE=Debug >/dev/null
	$(BIN)/cmake --build build/tsan
	build/tsan/hostile 60

count: install
	PATH=$(abspath $(BIN)):$$PATH $(BIN)/python tools/count_instructions.py

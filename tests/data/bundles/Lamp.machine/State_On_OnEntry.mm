{
	using namespace std;
	++count;
}
